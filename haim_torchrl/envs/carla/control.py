"""From an action to CARLA's pedals and steering wheel."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from haim_torchrl.envs.carla.package import carla_package
from haim_torchrl.envs.carriageway import CarModel

STEERING = 0.5
"""Largest front-wheel angle that an action asks for [rad], as in the platoon's world."""
THROTTLE, BRAKING = 4.0, 8.0
"""Acceleration and deceleration that full pedals are taken to give [m/s²]."""
MAX_SPEED = 15.0
"""The throttle is let go at this speed [m/s], the followers' desired speed."""
WHEELBASE = 2.9
"""Distance of the AV's axles [m]: that of the real Tesla Model 3, rounded."""


def car_model(length: float, width: float) -> CarModel:
    """What the forecast and the expert take the AV to be.

    Pedals are nominal: CARLA's cars have gears, tyres and air resistance. What the AV really did is
    measured at each step.

    Args:
        length, width: of its bounding box [m].
    """
    return CarModel(length, width, WHEELBASE, STEERING, THROTTLE, BRAKING, MAX_SPEED)


def control_of(action: np.ndarray, speed: float, full_lock: float) -> Any:
    """The ``carla.VehicleControl`` of an action.

    Args:
        action: acceleration and steering in [-1, 1]², others are clipped; steering positive to
            the right, as CARLA's. Never reverses.
        speed: the AV's speed [m/s].
        full_lock: front-wheel angle of CARLA's steer = 1 [rad].

    Raises:
        ValueError: the action is not two finite numbers.
    """
    pedal, wheel = map(float, action)
    if not (math.isfinite(pedal) and math.isfinite(wheel)):
        raise ValueError(f"action: must be two finite numbers, got {[pedal, wheel]}")
    pedal, wheel = min(max(pedal, -1.0), 1.0), min(max(wheel, -1.0), 1.0)
    return carla_package().VehicleControl(
        throttle=max(pedal, 0.0) if speed < MAX_SPEED else 0.0,
        brake=max(-pedal, 0.0),
        steer=min(max(wheel * STEERING / full_lock, -1.0), 1.0),
    )
