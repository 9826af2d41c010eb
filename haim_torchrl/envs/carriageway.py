"""What drivers and forecasts know of a world: the AV's carriageway, its car, and what is on it.

Both the expert driver and the risk forecast are written against this, and so serve every
simulator that can fill it in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from haim_torchrl.envs.path import Array, Path


@dataclass(frozen=True)
class Carriageway:
    """The lanes along the AV's route, all of one width.

    Attributes:
        route: centre line.
        lanes: number of lanes.
        lane_width: width of each [m].
    """

    route: Path
    lanes: int
    lane_width: float

    @property
    def half_width(self) -> float:
        """From the centre line to either edge [m]."""
        return self.lanes * self.lane_width / 2

    def lane_at(self, d: float) -> int:
        """Lane at an offset [m] from the route, or the nearest one (0 is leftmost)."""
        return min(max(int((d + self.half_width) // self.lane_width), 0), self.lanes - 1)

    def lane_offset(self, lane: int) -> float:
        """Offset of a lane's middle from the route [m], positive to the right."""
        return (lane - (self.lanes - 1) / 2) * self.lane_width


@dataclass(frozen=True)
class CarModel:
    """A kinematic bicycle with limits.

    Attributes:
        length, width: of the body [m].
        wheelbase: distance of its axles [m].
        steering: largest front-wheel angle [rad].
        throttle, braking: acceleration and deceleration that full pedals give [m/s²].
        max_speed: speed that it does not exceed [m/s].
    """

    length: float
    width: float
    wheelbase: float
    steering: float
    throttle: float
    braking: float
    max_speed: float

    def command(self, pedal: float, wheel: float) -> tuple[float, float]:
        """Acceleration [m/s²] and front-wheel angle [rad] of an action in [-1, 1]²."""
        return pedal * (self.throttle if pedal > 0 else self.braking), wheel * self.steering

    def action(self, acceleration: float, angle: float) -> tuple[float, float]:
        """The action that gives an acceleration [m/s²] and a front-wheel angle [rad]."""
        pedal = acceleration / (self.throttle if acceleration > 0 else self.braking)
        return pedal, angle / self.steering


class Car(Protocol):
    """The AV: centre [m, m], heading [rad], speed [m/s], and what it can do."""

    @property
    def position(self) -> Array: ...

    @property
    def heading(self) -> float: ...

    @property
    def speed(self) -> float: ...

    @property
    def model(self) -> CarModel: ...


class Lane(Protocol):
    """A lane of the route: its middle, and how fast it may be driven."""

    @property
    def path(self) -> Path: ...

    def speed_at(self, s: float) -> float:
        """Speed [m/s] that keeps the bends ahead of arc length `s` [m] comfortable."""
        ...


class Surroundings(Protocol):
    """The scene now, in the frame of :mod:`haim_torchrl.envs.path` (y to the right).

    Attributes:
        av: the automated vehicle.
        bodies: everything, [M, 10] (:mod:`haim_torchrl.envs.geometry`): the AV, its followers,
            all others.
        followers: number of followers.
        route_s, route_d: arc length and offset of each body on the route [m], shape [M].
    """

    @property
    def av(self) -> Car: ...

    @property
    def bodies(self) -> Array: ...

    @property
    def followers(self) -> int: ...

    @property
    def route_s(self) -> Array: ...

    @property
    def route_d(self) -> Array: ...

    @property
    def scenario(self) -> Carriageway: ...

    @property
    def lanes(self) -> Sequence[Lane]: ...

    @property
    def others(self) -> Array:
        """Bodies other than the AV and its followers."""
        ...

    def predicted(self) -> Array:
        """Their poses over the coming seconds, [T, M, 3], one every 0.2 s."""
        ...
