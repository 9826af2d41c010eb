"""The road of a scenario as highway-env sees it, with fast neighbour search and collision tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.lane import LineType
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import RoadObject

from haim_torchrl.envs import geometry
from haim_torchrl.envs.blocks import lane_offset
from haim_torchrl.envs.geometry import COLUMNS, PATH, SPEED, X, Y
from haim_torchrl.envs.lanes import PathLane
from haim_torchrl.envs.path import Array
from haim_torchrl.envs.planning import PREDICTION_STEP
from haim_torchrl.envs.platoon import Platoon
from haim_torchrl.envs.scenario import Scenario
from haim_torchrl.envs.vehicles import (
    AutomatedVehicle,
    LaneIndex,
    RoadObstacle,
    StoppedVehicle,
    TrafficVehicle,
)

REACH = 1.4
"""A body stands on a lane's path when its centre is closer than this plus its half width [m]."""
ROOM = 10.0
"""Traffic enters only where everybody else's centre is farther away than this [m]."""
STUCK_STEPS = 200
"""Traffic that has stood still for this many steps without cause is removed."""
HORIZON = 20
"""Instants that other vehicles' motion is predicted for."""


def body_of(thing: RoadObject, acceleration: float = 0.0, path: int = -1) -> tuple[float, ...]:
    """The row of a vehicle or obstacle among the bodies; not yet located on its path.

    Args:
        thing: the vehicle or obstacle.
        acceleration: its acceleration [m/s²].
        path: index of the path that it drives; -1: none.
    """
    x, y = thing.position.tolist()
    half_length, half_width = thing.LENGTH / 2, thing.WIDTH / 2
    s, d = 0.0, 0.0
    return x, y, thing.heading, thing.speed, acceleration, half_length, half_width, path, s, d


class PlatoonRoad(Road):
    """Lanes, vehicles and obstacles of one episode.

    Attributes:
        scenario: what was drawn for this episode.
        av: the automated vehicle.
        platoon: its followers.
        bodies: all bodies as rows (see :mod:`haim_torchrl.envs.geometry`): the AV first, then the
            followers, then everything else. Made anew each step.
        route_s, route_d: arc length and offset of each body on the route [m], shape [M].
    """

    vehicles: list[Any]
    objects: list[RoadObject]

    def __init__(
        self,
        scenario: Scenario,
        av: AutomatedVehicle,
        platoon: Platoon,
        rng: np.random.RandomState,
    ) -> None:
        network = RoadNetwork()
        self.scenario = scenario
        self.lanes: list[PathLane] = []
        self.indices: list[LaneIndex] = []
        self._path_of: dict[LaneIndex, int] = {}
        for k in range(scenario.lanes):
            types = (
                LineType.CONTINUOUS if k == 0 else LineType.STRIPED,
                LineType.CONTINUOUS if k == scenario.lanes - 1 else LineType.NONE,
            )
            path = scenario.route.shifted(lane_offset(k, scenario.lanes))
            self._add(network, ("start", "destination", k), PathLane(path, types))
        dashed = (LineType.STRIPED, LineType.STRIPED)
        for k, side in enumerate(scenario.sides):
            self._add(network, (f"side {k}", f"end {k}", 0), PathLane(side.path, dashed))
        self.xs = np.concatenate([lane.path.x for lane in self.lanes])
        self.ys = np.concatenate([lane.path.y for lane in self.lanes])
        self.headings = np.concatenate([lane.path.heading for lane in self.lanes])
        self.starts = np.cumsum([0] + [len(lane.path.x) for lane in self.lanes])
        super().__init__(network, [av, *platoon.vehicles], [], rng)
        self.av, self.platoon = av, platoon
        self._waiting_spawns = list(scenario.spawns)
        self._add_obstacles()
        self._motion: dict[int, tuple[float, float]] = {}
        self._predicted: Array | None = None
        self.bodies = np.zeros((0, COLUMNS))
        self.refresh()
        self.spawn()

    def _add(self, network: RoadNetwork, index: LaneIndex, lane: PathLane) -> None:
        network.add_lane(index[0], index[1], lane)
        self._path_of[index] = len(self.lanes)
        self.lanes.append(lane)
        self.indices.append(index)

    def _add_obstacles(self) -> None:
        for placed in self.scenario.obstacles:
            index = ("start", "destination", placed.lane)
            lane = self.lanes[placed.lane]
            s = lane.path.project(self.scenario.route.at(placed.s))[0]
            if placed.kind in ("cones", "triangle"):
                x, y, heading = lane.path.at(s)
                self.objects.append(RoadObstacle(placed.kind, np.array([x, y]), heading))
            if placed.kind in ("stopped", "triangle"):
                back = 12.0 if placed.kind == "triangle" else 0.0
                self.vehicles.append(StoppedVehicle(self, index, s + back, 0.0))
            if placed.kind == "slow":
                self.vehicles.append(StoppedVehicle(self, index, s, 2.5))

    # What every body is and where.
    def refresh(self, dt: float | None = None) -> None:
        """Gather the bodies anew.

        Args:
            dt: for how long everything has moved since the last time [s]; None: nothing has moved,
                but something came or went, and accelerations are what they were.
        """
        things = [*self.vehicles, *self.objects]
        rows = []
        motion = {}
        for thing in things:
            speed, acceleration = self._motion.get(id(thing), (thing.speed, 0.0))
            if dt is not None:
                acceleration = (thing.speed - speed) / dt
            motion[id(thing)] = thing.speed, acceleration
            path = -1
            if isinstance(thing, TrafficVehicle):
                path = self._path_of[thing.target_lane_index]
            elif isinstance(thing, StoppedVehicle):
                path = self._path_of[thing.lane_index]
            rows.append(body_of(thing, acceleration, path))
        self._motion = motion
        self.things = things
        self._rows = {id(thing): k for k, thing in enumerate(things)}
        self.bodies, self.followers = np.array(rows), len(self.platoon.vehicles)
        self._predicted = None
        geometry.locate(self.bodies, self.xs, self.ys, self.headings, self.starts)
        route = self.scenario.route
        self.route_s, self.route_d = geometry.along(self.bodies, route.x, route.y, route.heading)
        for vehicle, d in zip(things[: 1 + self.followers], self.route_d.tolist(), strict=False):
            k = self.scenario.lane_at(d)
            vehicle.lane_index, vehicle.lane = self.indices[k], self.lanes[k]

    @property
    def others(self) -> Array:
        """Bodies other than the AV and its followers, [M, 10]."""
        return self.bodies[1 + self.followers :]

    def predicted(self) -> Array:
        """Poses of :attr:`others` over the coming seconds, [T, M, 3], one every 0.2 s."""
        if self._predicted is None:
            self._predicted = geometry.predict(
                self.others, self.xs, self.ys, self.headings, self.starts, HORIZON, PREDICTION_STEP
            )
        return self._predicted

    def route_lane_index(self, position: np.ndarray) -> LaneIndex:
        """The lane of the route that a position [m, m] is on, or nearest to."""
        return self.indices[self.scenario.lane_at(self.scenario.route.project(position)[1])]

    # highway-env asks these.
    def neighbour_vehicles(
        self, vehicle: Vehicle, lane_index: LaneIndex | None = None
    ) -> tuple[Any, Any]:
        """Leader and follower of a vehicle along a whole lane, obstacles included."""
        lane = self.network.get_lane(lane_index or vehicle.lane_index)
        path = lane.path
        front, rear = geometry.neighbours(
            self._rows[id(vehicle)], self.bodies, path.x, path.y, path.heading, REACH
        )
        things = self.things
        return (
            things[front] if front >= 0 else None,
            things[rear] if rear >= 0 else None,
        )

    def act(self) -> None:
        for vehicle in self.vehicles:
            vehicle.act()

    def step(self, dt: float) -> None:
        """Move everything by one time step [s]; followers last, behind where the AV went."""
        for vehicle in self.vehicles:
            vehicle.step(dt)
        self.platoon.step(self.av.position, self.av.speed, self._moved_others(), dt)
        self.vehicles = [v for v in self.vehicles if not self._gone(v)]
        self.refresh(dt)
        self.spawn()

    def _moved_others(self) -> Array:
        rest = [*self.vehicles[1 + self.followers :], *self.objects]
        return np.array([body_of(thing) for thing in rest]).reshape(-1, COLUMNS)

    def _gone(self, vehicle: Vehicle) -> bool:
        if not isinstance(vehicle, TrafficVehicle):
            return False
        s, _ = vehicle.lane.local_coordinates(vehicle.position)
        return s > vehicle.lane.length - 2.0 or vehicle.stood_still > STUCK_STEPS

    def spawn(self) -> None:
        """Let traffic in that the AV has come near to, where there is room."""
        s_av = self.route_s[0]
        entered: list[tuple[int, float]] = []
        while self._waiting_spawns and self._waiting_spawns[0].trigger <= s_av:
            spawn = self._waiting_spawns.pop(0)
            k = spawn.lane if spawn.lane is not None else self.scenario.lanes + (spawn.side or 0)
            x, y, _ = self.lanes[k].path.at(spawn.s)
            gaps = np.hypot(self.bodies[:, X] - x, self.bodies[:, Y] - y)
            free = all(k != path or abs(s - spawn.s) > ROOM for path, s in entered)
            if free and gaps.min() > ROOM:
                self.vehicles.append(TrafficVehicle(self, self.indices[k], spawn))
                entered.append((k, spawn.s))
        if entered:
            self.refresh()

    # Priority at junctions.
    def give_way_line(self, vehicle: TrafficVehicle) -> float | None:
        """Arc length [m] at which a side-road driver waits; None on the route."""
        side = vehicle.spawn.side
        return None if side is None else self.scenario.sides[side].give_way_at

    def must_give_way(self, vehicle: TrafficVehicle) -> bool:
        """Whether someone on the route reaches the conflict zone within the driver's patience."""
        side = vehicle.spawn.side
        conflict = None if side is None else self.scenario.sides[side].conflict
        if conflict is None:
            return False
        own = self.scenario.lanes + (side or 0)
        ahead = conflict[0] - self.route_s
        on_route = (np.abs(self.route_d) < self.scenario.half_width) & (self.bodies[:, PATH] != own)
        on_route &= (self.bodies[:, SPEED] > 0.3) | (ahead < 0)
        arrives = ahead < vehicle.spawn.patience * np.maximum(self.bodies[:, SPEED], 2.0)
        return bool((on_route & arrives & (self.route_s < conflict[1] + 3.0)).any())

    def collision_partners(self) -> list[int]:
        """Rows of the bodies that the AV touches."""
        return geometry.touching(self.bodies).tolist()

    def remove(self, rows: list[int]) -> None:
        """Take bodies off the road, except the AV and its followers."""
        gone = {row for row in rows if row > self.followers}
        things = [*self.vehicles, *self.objects]
        kept = {id(thing) for k, thing in enumerate(things) if k not in gone}
        self.vehicles = [v for v in self.vehicles if id(v) in kept]
        self.objects = [o for o in self.objects if id(o) in kept]
        self.refresh()
