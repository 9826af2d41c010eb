"""The road from above."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pygame

from haim_torchrl.evaluation.pictures import COLORS
from haim_torchrl.evaluation.recording import RoadLine
from haim_torchrl.human.window.camera import Array, Camera, band, polygon, runs, sides

GROUND, ASPHALT = "#dde3d8", "#fafaf8"
MARKING = "#b4b4b4"
DASH, SPACE = 3.0, 4.5
"""Lengths of a dash and of the gap after it [m]."""
ROUTE_WIDTH, MARKING_WIDTH, EDGE_WIDTH = 0.9, 0.16, 0.24
"""Widths of what is drawn [m]."""
SPACING = 2.0
"""Distance between the points of a line [m]; in a bend of 10 m a chord is 5 cm off."""
WIDEST = 6.0
"""Lines that begin and end less than this apart bound a lane [m]."""


class Road:
    """The lines of an episode, ready to be drawn.

    Args:
        lines: as the simulator offers them. Where two that follow each other run side by side, the
            area between them is asphalt.
    """

    def __init__(self, lines: list[RoadLine]) -> None:
        points = [_thinned(np.asarray(line.points, dtype=float)[:, :2]) for line in lines]
        pairs = [(line, p) for line, p in zip(lines, points) if len(p) > 1]
        painted = [p for line, p in pairs if not line.route]
        self._lanes = [
            (a, _resampled(b, len(a)))
            for a, b in pairwise(painted)
            if max(np.linalg.norm(a[0] - b[0]), np.linalg.norm(a[-1] - b[-1])) < WIDEST
        ]
        self._routes = [sides(p, ROUTE_WIDTH / 2) for line, p in pairs if line.route]
        self._edges = [
            (*sides(p, EDGE_WIDTH / 2), p) for line, p in pairs if line.edge and not line.route
        ]
        marked = (_dashes(p) for line, p in pairs if not line.edge and not line.route)
        self._dashes = np.concatenate([np.zeros((0, 4, 2)), *marked])

    def draw(self, surface: Any, camera: Camera) -> None:
        """Draw what the camera shows."""
        for color, bands in ((ASPHALT, self._lanes), (COLORS["route"], self._routes)):
            for left, right in bands:
                one, other = camera.pixels(left), camera.pixels(right)
                for run in runs(camera.shows(one)):
                    band(surface, color, one[run], other[run])
        dashes = camera.pixels(self._dashes)
        for dash in dashes[camera.shows(dashes[:, 0])]:
            polygon(surface, MARKING, dash)
        for lines in self._edges:
            # Three smooth lines side by side: too thin for an area.
            places = [camera.pixels(line) for line in lines]
            for run in runs(camera.shows(places[-1])):
                for place in places if run.stop - run.start > 1 else ():
                    pygame.draw.aalines(surface, COLORS["edge"], False, place[run].tolist())


def _dashes(points: Array) -> Array:
    """The dashes of a marking, ``[n, 4, 2]``: their corners, in m."""
    s = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    starts = np.arange(0.0, s[-1] - DASH + 1e-9, DASH + SPACE)
    ends = np.stack([starts, starts + DASH], axis=1)
    lines = np.stack([np.interp(ends, s, points[:, k]) for k in (0, 1)], axis=-1)
    corners = [np.stack(sides(line, MARKING_WIDTH / 2)).reshape(4, 2) for line in lines]
    return np.array(corners).reshape(-1, 4, 2)[:, [0, 1, 3, 2]]


def _thinned(points: Array) -> Array:
    """The line without points that lie closer together than it takes to draw it."""
    if len(points) < 3:
        return points
    s = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    cell = np.floor(s / SPACING)
    keep = np.concatenate(([True], cell[1:-1] > cell[:-2], [True]))
    return points[keep]


def _resampled(points: Array, count: int) -> Array:
    """The line with ``count`` points."""
    at, have = np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(points))
    return np.stack([np.interp(at, have, points[:, k]) for k in (0, 1)], axis=1)
