"""What is on MetaDrive's road around the AV, in the form that forecast and expert read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from haim_torchrl.envs import geometry
from haim_torchrl.envs.carriageway import CarModel, Carriageway
from haim_torchrl.envs.geometry import PATH, SPEED, X, Y
from haim_torchrl.envs.lanes import PathLane
from haim_torchrl.envs.metadrive.followers import FollowerManager, body, centre
from haim_torchrl.envs.metadrive.route import carriageway, way_of
from haim_torchrl.envs.path import Array
from haim_torchrl.envs.planning import PREDICTION_STEP
from haim_torchrl.envs.platoon import Platoon

HORIZON = 20
"""Instants that other vehicles' motion is predicted for."""
SURGE, DRIFT = 1.0, 1.0
"""How long traffic that accelerates, or moves out of its lane, is expected to go on doing so [s].
MetaDrive's drivers merge without a look, and speed up while they do."""
REACH = 80.0
"""How far from the AV things are looked at [m]."""
ON_LANE = 1.4
"""A thing is on a lane when its centre is closer to it than this plus its half width [m]."""


@dataclass
class AutomatedCar:
    """The AV as forecast and expert see it; see :class:`~haim_torchrl.envs.carriageway.Car`."""

    position: Array
    heading: float
    speed: float
    model: CarModel


class MetaDriveRoad:
    """The scene of one episode; fulfils :class:`~haim_torchrl.envs.carriageway.Surroundings`.

    Bodies are gathered when somebody asks for them, at most once a step.

    Args:
        env: MetaDrive's environment, just reset.
        platoon: the followers.
        lanes, lane_width: of each road.
        model: what the AV can do.

    Attributes:
        scenario: the AV's carriageway.
        lanes: its lanes.
    """

    def __init__(
        self, env: Any, platoon: Platoon, lanes: int, lane_width: float, model: CarModel
    ) -> None:
        self._env, self._engine, self.platoon = env, env.engine, platoon
        agent = env.agent
        self._graph = env.current_map.road_network.graph
        self.scenario: Carriageway = carriageway(
            self._graph, agent.navigation.checkpoints, lanes, lane_width
        )
        route = self.scenario.route
        self.lanes = [PathLane(route.shifted(self.scenario.lane_offset(k))) for k in range(lanes)]
        self._paths = [lane.path for lane in self.lanes]
        self._path_of: dict[tuple[str, Any], int] = {}
        self._tables: tuple[Array, Array, Array, np.ndarray] | None = None
        self.av = AutomatedCar(np.zeros(2), 0.0, 0.0, model)
        self.followers = len(platoon.speeds)
        self._speeds: dict[str, tuple[int, float]] = {}
        self._bodies: Array | None = None
        self._along: tuple[Array, Array] | None = None
        self._predicted: Array | None = None
        self.refresh()

    def refresh(self) -> None:
        """Look at the AV anew, and forget what was gathered of the others."""
        agent = self._env.agent
        x, y = centre(agent)
        self.av.position = np.array([x, -y])
        self.av.heading, self.av.speed = -float(agent.heading_theta), float(agent.speed)
        self._bodies = self._along = self._predicted = None

    @property
    def av_on_route(self) -> tuple[float, float]:
        """The AV's arc length and offset on its route [m]."""
        return self.scenario.route.project(self.av.position)

    @property
    def bodies(self) -> Array:
        """Everything within reach, [M, 10]: the AV, its followers, all others."""
        if self._bodies is None:
            self._bodies = self._gather()
        return self._bodies

    @property
    def others(self) -> Array:
        """Bodies other than the AV and its followers."""
        return self.bodies[1 + self.followers :]

    @property
    def route_s(self) -> Array:
        """Arc length of each body on the route [m], [M]."""
        return self._on_route()[0]

    @property
    def route_d(self) -> Array:
        """Offset of each body from the route [m], [M]."""
        return self._on_route()[1]

    def _on_route(self) -> tuple[Array, Array]:
        if self._along is None:
            route = self.scenario.route
            self._along = geometry.along(self.bodies, route.x, route.y, route.heading)
        return self._along

    def predicted(self) -> Array:
        """Poses of :attr:`others` over the coming seconds, [T, M, 3], one every 0.2 s."""
        if self._predicted is None:
            others = self.others
            self._predicted = geometry.predict(
                others, *self._table(), HORIZON, PREDICTION_STEP, SURGE, DRIFT
            )
        return self._predicted

    def held_up(self, slow: float) -> bool:
        """Whether traffic that is no faster than `slow` [m/s] is close ahead in the AV's lane.

        What stands for good (a breakdown, cones) holds nobody up: it is to be driven round.
        """
        lane = self.lanes[self.scenario.lane_at(float(self.route_d[0]))].path
        front, _ = geometry.neighbours(0, self.bodies, lane.x, lane.y, lane.heading, ON_LANE)
        if front < 0:
            return False
        leader = self.bodies[front]
        away = float(np.hypot(leader[X] - self.av.position[0], leader[Y] - self.av.position[1]))
        return bool(
            leader[PATH] >= 0 and leader[SPEED] < slow + 1.0 and away < 12.0 + 1.5 * self.av.speed
        )

    def _gather(self) -> Array:
        av, model, platoon = self.av, self.av.model, self.platoon
        half_length, half_width = model.length / 2, model.width / 2
        rows: list[tuple[float, ...]] = [
            (*av.position, av.heading, av.speed, 0.0, half_length, half_width, -1, 0.0, 0.0)
        ]
        half_length, half_width = FollowerManager.LENGTH / 2, FollowerManager.WIDTH / 2
        for pose, speed, acceleration in zip(
            platoon.poses.tolist(), platoon.speeds.tolist(), platoon.accelerations.tolist()
        ):
            rows.append((*pose, speed, acceleration, half_length, half_width, -1, 0.0, 0.0))
        x, y = av.position[0], -av.position[1]
        own, agent = self._engine.follower_manager.spawned_objects, self._env.agent
        for name, thing in self._engine.get_objects().items():
            if name in own or thing is agent:
                continue
            px, py = centre(thing)
            if abs(px - x) < REACH and abs(py - y) < REACH:
                path = self._path(name, thing)
                rows.append(body(thing, self._acceleration(name, thing), path, stands=path < 0))
        bodies = np.array(rows, dtype=float)
        geometry.locate(bodies, *self._table())
        return bodies

    def _acceleration(self, name: str, thing: Any) -> float:
        """Change of speed since the last look, if that was a step ago [m/s²]."""
        step, speed = self._engine.episode_step, float(thing.speed)
        before = self._speeds.get(name)
        self._speeds[name] = step, speed
        return 10.0 * (speed - before[1]) if before is not None and before[0] == step - 1 else 0.0

    def _path(self, name: str, thing: Any) -> int:
        """Index of the path that a vehicle drives; -1 of what only stands."""
        policy = self._engine.get_policy(name)
        if policy is None:  # MetaDrive's own flag of a breakdown outlives the episode
            return -1
        target = getattr(policy, "routing_target_lane", None) or thing.lane
        key = name, target.index
        if key not in self._path_of:
            self._path_of[key] = len(self._paths)
            self._paths.append(way_of(thing, target, self._graph))
            self._tables = None
        return self._path_of[key]

    def _table(self) -> tuple[Array, Array, Array, np.ndarray]:
        """All paths one after the other, as :func:`~haim_torchrl.envs.geometry.predict` wants."""
        if self._tables is None:
            paths = self._paths
            self._tables = (
                np.concatenate([path.x for path in paths]),
                np.concatenate([path.y for path in paths]),
                np.concatenate([path.heading for path in paths]),
                np.cumsum([0] + [len(path.x) for path in paths]),
            )
        return self._tables
