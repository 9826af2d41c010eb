"""The vehicles of the X+1+N scene: the automated one, its followers, the traffic, and obstacles."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from highway_env.utils import not_zero, wrap_to_pi
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Obstacle
from numpy.typing import NDArray

from haim_torchrl.envs.carriageway import CarModel
from haim_torchrl.envs.scenario import Spawn

if TYPE_CHECKING:
    from haim_torchrl.envs.road import PlatoonRoad

LaneIndex = tuple[str, str, int]
"""highway-env's name of a lane: start and end of the road, and the lane's number."""
BRAKING, THROTTLE = 8.0, 4.0
"""Strongest deceleration and acceleration of the automated vehicle [m/s²]."""
STEERING = 0.5
"""Largest front-wheel angle of the automated vehicle [rad]: a turning radius of 9.5 m."""


class AutomatedVehicle(Vehicle):
    """The AV: highway-env's kinematic bicycle, with a speed in [0, 15] m/s.

    An action is (acceleration, steering), both in [-1, 1]. The first is mapped piecewise, -1 to
    -8 m/s², 0 to 0 and +1 to +4 m/s²: an affine map would make the zero action brake, and the
    usual range of ±5 m/s² never goes below the disturbance threshold of -5 m/s².
    """

    MIN_SPEED = 0.0
    MAX_SPEED = 15.0
    # highway-env's bicycle takes the length of the body for its wheelbase.
    model = CarModel(
        Vehicle.LENGTH, Vehicle.WIDTH, Vehicle.LENGTH, STEERING, THROTTLE, BRAKING, MAX_SPEED
    )
    target_speed = 12.0  # what MOBIL drivers assume of it when they consider cutting in
    color = (50, 200, 0)
    speed: float
    position: NDArray[np.float64]

    def drive(self, action: np.ndarray) -> None:
        """Set the command of the next step from an action in [-1, 1]²; others are clipped."""
        self.action = command(action)

    def step(self, dt: float) -> None:
        delta = self.action["steering"]
        beta = np.arctan(np.tan(delta) / 2)
        direction = self.heading + beta
        before = self.speed
        speed = before + self.action["acceleration"] * dt
        self.speed = min(max(speed, self.MIN_SPEED), self.MAX_SPEED)
        self.position = self.position + before * dt * np.array(
            [np.cos(direction), np.sin(direction)]
        )
        self.heading += before * np.sin(beta) / (self.LENGTH / 2) * dt

    def on_state_update(self) -> None:
        """The road keeps track of where the AV is."""


def command(action: np.ndarray) -> dict[str, float]:
    """The command of an action in [-1, 1]² in physical units; actions outside are clipped.

    Args:
        action: acceleration and steering, shape [2].

    Returns:
        ``acceleration`` [m/s²] and ``steering`` (front-wheel angle) [rad].

    Raises:
        ValueError: the action is not two finite numbers.
    """
    pedal, wheel = map(float, action)
    if not (math.isfinite(pedal) and math.isfinite(wheel)):
        raise ValueError(f"action: must be two finite numbers, got {[pedal, wheel]}")
    acceleration, angle = AutomatedVehicle.model.command(clip(pedal, 1.0), clip(wheel, 1.0))
    return {"acceleration": acceleration, "steering": angle}


def clip(value: float, limit: float) -> float:
    """The value, bounded to [-limit, limit]; for a single number much faster than NumPy's."""
    return min(max(value, -limit), limit)


class FollowerVehicle(Vehicle):
    """A human driver behind the AV; the platoon moves it along the AV's trail."""

    target_speed = 15.0  # what MOBIL drivers assume of it
    color = (200, 0, 150)

    def act(self, action: Any = None) -> None:
        """Followers are moved by :class:`haim_torchrl.envs.platoon.Platoon`."""

    def step(self, dt: float) -> None:
        """Followers are moved by :class:`haim_torchrl.envs.platoon.Platoon`."""

    def on_state_update(self) -> None:
        """Followers have no lane of their own."""


class TrafficVehicle(IDMVehicle):
    """highway-env's IDM/MOBIL driver on path lanes.

    It slows down for bends, and on a side road it waits at the give-way line for a gap.
    Collisions among traffic are not checked: two crashed traffic vehicles would block the road
    for good, and most failed expert episodes in earlier trials were such deadlocks.
    """

    MIN_SPEED = 0.0
    COMFORT_ACC_MAX = 2.5
    COMFORT_ACC_MIN = -3.5
    TIME_WANTED = 1.2
    DISTANCE_WANTED = 3.0 + Vehicle.LENGTH

    road: PlatoonRoad
    speed: float

    def __init__(self, road: PlatoonRoad, lane_index: LaneIndex, spawn: Spawn) -> None:
        lane = road.network.get_lane(lane_index)
        x, y, heading = lane.path.at(spawn.s)
        # highway-env would search all lanes for the closest; the spawn knows it.
        super().__init__(None, np.array([x, y]), heading, min(spawn.speed, lane.speed_at(spawn.s)))
        self.road = road
        self.lane_index = self.target_lane_index = lane_index
        self.lane = lane
        self.spawn = spawn
        self.enable_lane_change = spawn.side is None
        self.check_collisions = False
        self.waiting = False
        self.stood_still = 0
        self.timer = float(np.sum(self.position) * np.pi) % self.LANE_CHANGE_DELAY

    def follow_road(self) -> None:
        """Lanes end with the route: there is no next one."""

    def steering_control(self, target_lane_index: LaneIndex) -> float:
        """highway-env's lateral controller, without array functions for single numbers.

        Returns:
            Front-wheel angle [rad].
        """
        lane = self.road.network.get_lane(target_lane_index)
        s, d = lane.local_coordinates(self.position)
        speed = not_zero(self.speed)
        ahead = lane.heading_at(s + self.speed * self.TAU_PURSUIT)
        back = float(np.arcsin(clip(-self.KP_LATERAL * d / speed, 1.0)))
        reference = ahead + clip(back, np.pi / 4)
        turn = self.KP_HEADING * wrap_to_pi(reference - self.heading)
        slip = np.arcsin(clip(self.LENGTH / 2 / speed * turn, 1.0))
        return clip(float(np.arctan(2 * np.tan(slip))), self.MAX_STEERING_ANGLE)

    def act(self, action: Any = None) -> None:
        """Decide by highway-env's MOBIL and IDM, and give way where the side road asks for it."""
        lane = self.road.network.get_lane(self.target_lane_index)
        s, _ = lane.local_coordinates(self.position)
        self.target_speed = max(min(self.spawn.speed, lane.speed_at(s)), 1.0)
        if self.enable_lane_change:
            self.change_lane_policy()
        acceleration = self._following(self.lane_index)
        if self.target_lane_index != self.lane_index:
            acceleration = min(acceleration, self._following(self.target_lane_index))
        line = self.road.give_way_line(self)
        self.waiting = line is not None and s < line and self.road.must_give_way(self)
        if line is not None and self.waiting:
            acceleration = min(acceleration, self._stopping(line - s - self.LENGTH / 2))
        self.action = {
            "steering": self.steering_control(self.target_lane_index),
            "acceleration": clip(acceleration, self.ACC_MAX),
        }

    def _following(self, lane_index: LaneIndex) -> float:
        front, rear = self.road.neighbour_vehicles(self, lane_index)
        return self.acceleration(self, front, rear)

    def _stopping(self, gap: float) -> float:
        """Acceleration [m/s²] of an IDM driver `gap` [m] before a standing obstacle."""
        braking = 2 * np.sqrt(self.COMFORT_ACC_MAX * -self.COMFORT_ACC_MIN)
        wanted = 1.0 + self.speed * 0.5 + self.speed**2 / braking
        return self.COMFORT_ACC_MAX * (1 - (wanted / max(gap, 0.1)) ** 2)

    def step(self, dt: float) -> None:
        super().step(dt)
        self.speed = max(self.speed, self.MIN_SPEED)
        self.stood_still = 0 if self.speed > 0.3 or self.waiting else self.stood_still + 1

    def on_state_update(self) -> None:
        if self.road is not None and self.enable_lane_change:
            self.lane_index = self.road.route_lane_index(self.position)
            self.lane = self.road.network.get_lane(self.lane_index)


class RoadObstacle(Obstacle):
    """A thing that closes a lane: a row of cones or a warning triangle.

    Both are wide: 30 m away a cone of 0.8 m falls between the rays, and clones of the mentor
    arrived less often with obstacles of that size than of 2.4 m (.55 against .70).
    """

    SIZES = {"cones": (3.0, 2.4), "triangle": (1.0, 1.6)}
    """Length and width of each kind [m]."""

    def __init__(self, kind: str, position: np.ndarray, heading: float) -> None:
        self.LENGTH, self.WIDTH = self.SIZES[kind]
        super().__init__(None, position, heading)
        self.kind = kind


class StoppedVehicle(Vehicle):
    """A broken-down vehicle, or one that crawls along its lane at a constant speed."""

    color = (100, 100, 100)

    def __init__(self, road: PlatoonRoad, lane_index: LaneIndex, s: float, speed: float):
        lane = road.network.get_lane(lane_index)
        x, y, heading = lane.path.at(s)
        super().__init__(None, np.array([x, y]), heading, speed)
        self.lane_index, self.lane, self.s = lane_index, lane, s
        self.check_collisions = False

    def act(self, action: Any = None) -> None:
        """Nobody decides anything here."""

    def step(self, dt: float) -> None:
        if self.speed > 0:
            self.s += self.speed * dt
            x, y, self.heading = self.lane.path.at(self.s)
            self.position = np.array([x, y])

    def on_state_update(self) -> None:
        """It keeps its lane."""
