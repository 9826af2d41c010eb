"""Paths: planar curves sampled every metre, and their projection and interpolation.

The whole world hangs on them: the AV's route, every lane, every side road and the
followers' trail are paths. Frame as in highway-env: x forward, y to the right, headings
grow clockwise as seen from above; a lateral offset d is positive to the right.

The compiled functions here are compiled into those of other modules, and numba's cache compares
only a function's own file: after a change here, remove the package's ``__pycache__`` folders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
SAMPLING_STEP = 1.0
"""Distance between two samples of a path [m]."""


@njit(cache=True)
def nearest(x: float, y: float, xs: Array, ys: Array) -> int:
    """Index of the sample of a path that is nearest to a point; the first of several.

    Two neighbouring samples are at most one metre apart, so a sample that is far from the point
    rules out as many of the next ones. A coarse look first tells how far "far" is. That visits
    about a tenth of the samples, and projections are what a step of the world mostly consists of.

    Args:
        x, y: the point [m].
        xs, ys: samples of the path [m], each of shape [K].
    """
    bound = np.inf
    for k in range(0, xs.shape[0], 16):
        bound = min(bound, (xs[k] - x) ** 2 + (ys[k] - y) ** 2)
    bound = np.sqrt(bound)
    best, best_distance = 0, np.inf
    k = 0
    while k < xs.shape[0]:
        distance = (xs[k] - x) ** 2 + (ys[k] - y) ** 2
        if distance < best_distance:
            best, best_distance = k, distance
        k += max(int(np.sqrt(distance) - bound), 1)
    return best


@njit(cache=True)
def project(x: float, y: float, xs: Array, ys: Array, headings: Array) -> tuple[float, float]:
    """Project a point on a path sampled every metre.

    Args:
        x, y: the point [m].
        xs, ys, headings: samples of the path [m, m, rad], each of shape [K].

    Returns:
        Arc length s [m] (negative before the start, beyond the length after the end) and
        lateral offset d [m], positive to the right.
    """
    best = nearest(x, y, xs, ys)
    cos, sin = np.cos(headings[best]), np.sin(headings[best])
    dx, dy = x - xs[best], y - ys[best]
    ahead = cos * dx + sin * dy
    right = -sin * dx + cos * dy
    # On an arc the tangent leaves the curve: turn (ahead, right) back by the local curvature.
    other = best + 1 if ahead >= 0 else best - 1
    if 0 <= other < xs.shape[0]:
        turn = headings[other] - headings[best]
        turn = (turn + np.pi) % (2 * np.pi) - np.pi
        curvature = turn if ahead >= 0 else -turn
        if abs(curvature) > 1e-9:
            radius = 1.0 / curvature
            angle = np.arctan2(ahead * np.sign(radius), (radius - right) * np.sign(radius))
            right = radius - np.sign(radius) * np.hypot(radius - right, ahead)
            ahead = radius * angle
    return best + ahead, right


@njit(cache=True)
def interpolate(
    s: float, d: float, xs: Array, ys: Array, headings: Array
) -> tuple[float, float, float]:
    """Position and heading at arc length `s` and lateral offset `d` of a path sampled every metre.

    Before the start and after the end the path goes on straight.

    Returns:
        x [m], y [m], heading [rad].
    """
    last = xs.shape[0] - 1
    k = min(max(int(np.floor(s)), 0), last)
    rest = s - k
    heading = headings[k]
    if k < last and rest > 0:
        turn = (headings[k + 1] - heading + np.pi) % (2 * np.pi) - np.pi
        x = xs[k] + rest * (xs[k + 1] - xs[k])
        y = ys[k] + rest * (ys[k + 1] - ys[k])
        heading += rest * turn
    else:
        x = xs[k] + rest * np.cos(heading)
        y = ys[k] + rest * np.sin(heading)
    return x - d * np.sin(heading), y + d * np.cos(heading), heading


@dataclass(frozen=True)
class Path:
    """A curve sampled every metre.

    Attributes:
        x, y: samples [m], shape [K].
        heading: tangent [rad], shape [K].
    """

    x: Array
    y: Array
    heading: Array

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(len(self.x) - 1) * SAMPLING_STEP

    def project(self, position: Sequence[float] | Array) -> tuple[float, float]:
        """Arc length s [m] and lateral offset d [m] of a position [m, m]."""
        return project(position[0], position[1], self.x, self.y, self.heading)

    def at(self, s: float, d: float = 0.0) -> tuple[float, float, float]:
        """Position x, y [m] and heading [rad] at arc length `s` and offset `d` [m]."""
        return interpolate(s, d, self.x, self.y, self.heading)

    def shifted(self, d: Array | float) -> Path:
        """The path at lateral offset `d` [m] (a number, or one per sample), sampled every metre."""
        offset = np.broadcast_to(np.asarray(d, dtype=float), self.x.shape)
        x = self.x - offset * np.sin(self.heading)
        y = self.y + offset * np.cos(self.heading)
        return Path.through(x, y)

    def part(self, start: float, end: float) -> Path:
        """The samples between two arc lengths [m]."""
        low, high = max(round(start), 0), min(round(end), len(self.x) - 1)
        cut = slice(low, high + 1)
        return Path(self.x[cut], self.y[cut], self.heading[cut])

    def then(self, other: Path) -> Path:
        """This path, continued by another one that starts where it ends."""
        return Path.through(
            np.concatenate([self.x, other.x[1:]]), np.concatenate([self.y, other.y[1:]])
        )

    @staticmethod
    def through(x: Array, y: Array) -> Path:
        """The path through points [m], resampled every metre.

        Raises:
            ValueError: the points span less than one metre.
        """
        steps = np.hypot(np.diff(x), np.diff(y))
        keep = np.concatenate([[True], steps > 1e-9])
        x, y = x[keep], y[keep]
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
        count = int(np.floor(arc[-1] / SAMPLING_STEP)) + 1
        if count < 2:
            raise ValueError(f"a path needs at least {SAMPLING_STEP} m, got {arc[-1]:.2f} m")
        grid = np.arange(count) * SAMPLING_STEP
        x, y = np.interp(grid, arc, x), np.interp(grid, arc, y)
        return Path(x, y, np.unwrap(np.arctan2(np.gradient(y), np.gradient(x))))


@dataclass(frozen=True)
class Piece:
    """A straight line or a circular arc.

    Attributes:
        length: arc length [m].
        curvature: 1/radius [1/m], positive to the right, 0 for a straight line.
    """

    length: float
    curvature: float = 0.0


def arc(radius: float, angle: float) -> Piece:
    """A turn by `angle` [rad], positive to the right, on a circle of `radius` [m]."""
    return Piece(radius * abs(angle), np.sign(angle) / radius)


def draw(pieces: Sequence[Piece], start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Path:
    """Chain straight lines and arcs into a path from a pose (x [m], y [m], heading [rad])."""
    fine = 0.1
    lengths = np.array([piece.length for piece in pieces])
    ends = np.cumsum(lengths)
    s = np.arange(0.0, ends[-1] + fine / 2, fine)
    curvature = np.array([piece.curvature for piece in pieces])[
        np.minimum(np.searchsorted(ends, s, side="right"), len(pieces) - 1)
    ]
    heading = start[2] + np.concatenate([[0.0], np.cumsum(curvature[:-1] * fine)])
    middle = heading + curvature * fine / 2
    x = start[0] + np.concatenate([[0.0], np.cumsum(np.cos(middle[:-1]) * fine)])
    y = start[1] + np.concatenate([[0.0], np.cumsum(np.sin(middle[:-1]) * fine)])
    step = round(SAMPLING_STEP / fine)
    return Path(x[::step].copy(), y[::step].copy(), heading[::step].copy())
