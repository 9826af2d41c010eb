"""A straight, empty road: the place for values by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from haim_torchrl.envs import PlatoonEnv
from haim_torchrl.envs.geometry import COLUMNS
from haim_torchrl.envs.vehicles import StoppedVehicle

EMPTY = {
    "blocks": {"straight": 1.0},
    "traffic_density": 0.0,
    "side_traffic": 0.0,
    "obstacles": (1.0,),
    "lanes": (2,),
}


@pytest.fixture
def empty_road() -> Callable[..., PlatoonEnv]:
    """Makes a world without anybody else: a straight road along +x with two lanes.

    The route's middle is y = 0, its lanes lie at y = -2 m (0) and y = 2 m (1), and the AV stands
    at x = 115 m.
    """

    def make(scenario: dict[str, Any] | None = None, **settings: Any) -> PlatoonEnv:
        env = PlatoonEnv({"scenario": EMPTY | (scenario or {}), **settings})
        env.reset(seed=0)
        return env

    return make


@pytest.fixture
def put_vehicle() -> Callable[..., StoppedVehicle]:
    """Puts a vehicle with a constant speed on a lane, with its centre `ahead` m before the AV's."""

    def put(env: PlatoonEnv, ahead: float, lane: int = 0, speed: float = 0.0) -> StoppedVehicle:
        s = env.scenario.route.project(env.vehicle.position)[0] + ahead
        vehicle = StoppedVehicle(env.road, ("start", "destination", lane), s, speed)
        env.road.vehicles.append(vehicle)
        env.road.refresh()
        return vehicle

    return put


@pytest.fixture
def body() -> Callable[..., np.ndarray]:
    """Makes a row of the table of bodies."""

    def make(
        x: float,
        y: float,
        heading: float = 0.0,
        speed: float = 0.0,
        size: tuple[float, float] = (5.0, 2.0),
        acceleration: float = 0.0,
        path: int = -1,
        s: float = 0.0,
        d: float = 0.0,
    ) -> np.ndarray:
        row = (x, y, heading, speed, acceleration, size[0] / 2, size[1] / 2, path, s, d)
        assert len(row) == COLUMNS
        return np.array(row, dtype=float)

    return make
