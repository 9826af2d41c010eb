"""The scene now, as the forecast and the expert read it (``Surroundings``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from haim_torchrl.envs import geometry
from haim_torchrl.envs.carla.frames import Pose
from haim_torchrl.envs.carriageway import Car, CarModel, Carriageway, Lane
from haim_torchrl.envs.geometry import COLUMNS, HALF_WIDTH, PATH
from haim_torchrl.envs.path import Array, Path
from haim_torchrl.envs.planning import PREDICTION_STEP
from haim_torchrl.envs.road import REACH

INSTANTS = 20
"""Instants that other vehicles' motion is predicted for."""


class Body(NamedTuple):
    """Something that takes up room.

    Attributes:
        kind: ``vehicle``, ``walker`` or ``prop``.
        pose: its middle.
        speed: [m/s].
        acceleration: over the last step [m/s²].
        length, width: [m].
        way: the middle of the lane that it drives along; None if it goes straight on.
    """

    kind: str
    pose: Pose
    speed: float
    acceleration: float
    length: float
    width: float
    way: Path | None = None

    @property
    def box(self) -> tuple[float, ...]:
        """x, y, heading, length, width."""
        return (*self.pose, self.length, self.width)


def body_rows(bodies: Sequence[Body]) -> Array:
    """Bodies as rows of :mod:`haim_torchrl.envs.geometry`, [M, 10], on no path."""
    rows = [
        (*b.pose, b.speed, b.acceleration, b.length / 2, b.width / 2, -1.0, 0.0, 0.0)
        for b in bodies
    ]
    return np.array(rows, dtype=float).reshape(-1, COLUMNS)


@dataclass
class SceneCar:
    """The AV."""

    position: Array
    heading: float
    speed: float
    model: CarModel


@dataclass
class RouteLane:
    """The lane that the route follows.

    Attributes:
        path: the part of it around the AV.
        speeds: comfortable speed at each sample [m/s], [K].
    """

    path: Path
    speeds: Array

    def speed_at(self, s: float) -> float:
        """Speed [m/s] that keeps the bends ahead of arc length `s` [m] comfortable."""
        return float(self.speeds[min(max(int(s), 0), len(self.speeds) - 1)])


class Scene:
    """What is around the AV, in the frame of :mod:`haim_torchrl.envs.path`.

    The carriageway is the lane of the route alone: lanes for oncoming traffic are no choice.

    Args:
        lane: the route's lane around the AV.
        lane_width: its width [m].
        model: what the AV can do.
        av: the AV's body.
        followers: those of its followers.
        rest: all others.
    """

    def __init__(
        self,
        lane: RouteLane,
        lane_width: float,
        model: CarModel,
        av: Body,
        followers: Sequence[Body],
        rest: Sequence[Body],
    ) -> None:
        self.av: Car = SceneCar(np.array(av.pose[:2]), av.pose[2], av.speed, model)
        self.followers = len(followers)
        self.scenario = Carriageway(lane.path, 1, lane_width)
        self.lanes: list[Lane] = [lane]
        self.bodies = body_rows([av, *followers, *rest])
        self.bodies[: 1 + self.followers, PATH] = 0
        ways = [lane.path]
        for row, body in enumerate(rest, 1 + self.followers):
            if body.way is not None:
                self.bodies[row, PATH] = len(ways)
                ways.append(body.way)
        self._starts = np.cumsum([0] + [len(way.x) for way in ways])
        self._xs = np.concatenate([way.x for way in ways])
        self._ys = np.concatenate([way.y for way in ways])
        self._headings = np.concatenate([way.heading for way in ways])
        geometry.locate(self.bodies, self._xs, self._ys, self._headings, self._starts)
        path = lane.path
        self.route_s, self.route_d = geometry.along(self.bodies, path.x, path.y, path.heading)

    @property
    def others(self) -> Array:
        """Bodies other than the AV and its followers, [M, 10]."""
        return self.bodies[1 + self.followers :]

    def predicted(self) -> Array:
        """Poses of :attr:`others` over the coming seconds, [T, M, 3], one every 0.2 s."""
        return self._predicted

    @cached_property
    def _predicted(self) -> Array:
        return geometry.predict(
            self.others, self._xs, self._ys, self._headings, self._starts, INSTANTS, PREDICTION_STEP
        )

    def held_up(self) -> bool:
        """Whether somebody is on the lane ahead of the AV, near enough to slow it down.

        What stands beside the middle of the lane, as obstacles do, is passed and no reason to wait.
        """
        ahead = self.route_s - self.route_s[0]
        near = (ahead > 0.0) & (ahead < 12.0 + 1.5 * self.av.speed)
        near &= np.abs(self.route_d) < REACH + self.bodies[:, HALF_WIDTH] - 1.0
        return bool(near.any())
