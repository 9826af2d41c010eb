"""A highway-env lane along a path, with projections fast enough for every vehicle and step."""

from __future__ import annotations

import math

import numpy as np
from highway_env.road.lane import AbstractLane, LineType

from haim_torchrl.envs.blocks import LANE_WIDTH
from haim_torchrl.envs.path import Array, Path

LATERAL_COMFORT = 2.5
"""Lateral acceleration that drivers accept in bends [m/s²]."""


class PathLane(AbstractLane):
    """A lane whose centre is a :class:`Path`.

    One lane covers the whole of a route or side road, so that no vehicle is ever blind across the
    end of a road segment (as it is with highway-env's own segments).

    Args:
        path: centre line.
        line_types: what is painted on the left and on the right.
    """

    def __init__(self, path: Path, line_types: tuple[int, int] | None = None) -> None:
        self.path = path
        self.length = path.length
        self.line_types = list(line_types or (LineType.NONE, LineType.NONE))
        self.forbidden = False
        self.speed_limit = None
        self.priority = 0
        self.speeds = comfortable_speeds(path)

    def position(self, longitudinal: float, lateral: float) -> np.ndarray:
        x, y, _ = self.path.at(float(longitudinal), float(lateral))
        return np.array([x, y])

    def heading_at(self, longitudinal: float) -> float:
        return self.path.at(float(longitudinal))[2]

    def local_coordinates(self, position: np.ndarray) -> tuple[float, float]:
        return self.path.project(position)

    def width_at(self, longitudinal: float) -> float:
        return LANE_WIDTH

    def speed_at(self, s: float) -> float:
        """Speed [m/s] that keeps the bends ahead of arc length `s` [m] comfortable."""
        return float(self.speeds[min(max(int(s), 0), len(self.speeds) - 1)])

    def to_config(self) -> dict:
        """The lane as highway-env's serialisable description."""
        return {"class_path": f"{__name__}.PathLane", "config": {"length": self.length}}


def comfortable_speeds(path: Path, comfort: float = LATERAL_COMFORT, braking: float = 1.5) -> Array:
    """Speed profile [m/s], shape [K]: comfortable in bends, slowing down ahead of them.

    Args:
        path: the path, K samples.
        comfort: lateral acceleration in bends [m/s²].
        braking: deceleration ahead of a bend [m/s²].
    """
    window = 5
    heading = np.pad(path.heading, window, mode="edge")
    curvature = np.abs(heading[2 * window :] - heading[: -2 * window]) / (2 * window)
    speeds = np.sqrt(comfort / np.maximum(curvature, 1e-3)).tolist()
    for k in range(len(speeds) - 2, -1, -1):
        speeds[k] = min(speeds[k], math.sqrt(speeds[k + 1] ** 2 + 2 * braking))
    return np.array(speeds)
