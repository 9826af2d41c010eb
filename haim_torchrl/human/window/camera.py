"""Where things of the world are on the screen, and smooth shapes there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

Array = NDArray[np.float64]
PIECE = 16
"""Points of a ribbon drawn at a time: a long one may cross itself, which a polygon must not."""


@dataclass(frozen=True)
class Camera:
    """A view from above.

    Attributes:
        centre: point of the world, in m, that is shown at ``origin``.
        up: direction of the world that is up on the screen, in rad counter-clockwise from +x.
        scale: pixels per metre.
        origin: pixel of the centre, from the upper left corner.
        area: width and height of the picture in pixels.
    """

    centre: tuple[float, float]
    up: float
    scale: float
    origin: tuple[float, float]
    area: tuple[int, int]

    def pixels(self, points: Array) -> Array:
        """Points ``[..., 2]`` in m as pixels ``[..., 2]``, downwards from the upper left corner."""
        turn = math.pi / 2.0 - self.up
        cos, sin = self.scale * math.cos(turn), self.scale * math.sin(turn)
        matrix = np.array([[cos, -sin], [-sin, -cos]])  # the second row points down
        return (np.asarray(points)[..., :2] - self.centre) @ matrix.T + self.origin

    def shows(self, pixels: Array, margin: float = 40.0) -> NDArray[np.bool_]:
        """Which of the pixels ``[..., 2]`` are in the picture or not far beyond its edge."""
        inside = (pixels > -margin) & (pixels < np.asarray(self.area) + margin)
        return np.asarray(inside.all(axis=-1))


def runs(mask: NDArray[np.bool_]) -> list[slice]:
    """The stretches in which a mask ``[n]`` holds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2])]


def polygon(surface: Any, color: str, points: Array, outline: str | None = None) -> None:
    """A filled polygon with smooth edges; ``points`` is ``[n, 2]`` in pixels."""
    pygame.draw.polygon(surface, color, np.rint(points).tolist())
    pygame.draw.aalines(surface, outline or color, True, points.tolist())


def ribbon(surface: Any, color: str, points: Array, half: float) -> None:
    """A line of ``2 * half`` pixels width; ``points`` is ``[n, 2]`` in pixels."""
    if len(points) > 1:
        left, right = sides(points, half)
        band(surface, color, left, right)
        pygame.draw.aalines(surface, color, False, points.tolist())


def sides(points: Array, half: float) -> tuple[Array, Array]:
    """The lines at ``half`` to both sides of a line ``[n, 2]``."""
    along = np.empty_like(points)
    along[1:-1] = points[2:] - points[:-2]
    along[0], along[-1] = points[1] - points[0], points[-1] - points[-2]
    along /= np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
    across = half * along[:, ::-1] * (-1.0, 1.0)
    return points + across, points - across


def band(surface: Any, color: str, left: Array, right: Array) -> None:
    """The area between two lines of as many points, ``[n, 2]`` each, in pixels."""
    one, other = np.rint(left).tolist(), np.rint(right).tolist()
    for start in range(0, len(one) - 1, PIECE):
        stop = start + PIECE + 1
        pygame.draw.polygon(surface, color, one[start:stop] + other[start:stop][::-1])
    if len(one) > 1:
        pygame.draw.aalines(surface, color, False, left.tolist())
        pygame.draw.aalines(surface, color, False, right.tolist())
