"""What MetaDrive's default car does with its pedals and its wheel; all numbers measured."""

from __future__ import annotations

import math
from typing import Any

from haim_torchrl.envs.carriageway import CarModel
from haim_torchrl.envs.metadrive.config import MetaDriveConfig

WHEELBASE = 2.5
"""Distance of the axles [m] that its yaw rates fit, up to a lateral acceleration of 7 m/s²."""
ENGINE, BRAKES = 2.76, 16.3
"""Acceleration at full throttle and deceleration per unit of brake [m/s²], at any speed."""
GRIP = 8.0
"""Deceleration at which the wheels begin to slip [m/s²]."""


def car_model(vehicle: Any, settings: MetaDriveConfig) -> CarModel:
    """The AV as forecast and expert see it.

    Args:
        vehicle: MetaDrive's vehicle.
        settings: settings of the world.
    """
    return CarModel(
        length=float(vehicle.LENGTH),
        width=float(vehicle.WIDTH),
        wheelbase=WHEELBASE,
        steering=settings.max_steering,
        throttle=ENGINE,
        braking=settings.max_braking,
        max_speed=settings.speed_limit,
    )


def to_metadrive(vehicle: Any, acceleration: float, angle: float) -> list[float]:
    """MetaDrive's action (steering to the left, throttle) for a command in physical units.

    Args:
        vehicle: MetaDrive's vehicle.
        acceleration: wanted [m/s²].
        angle: of the front wheels, positive to the right [rad].
    """
    pedal = acceleration / (ENGINE if acceleration > 0 else BRAKES)
    return [-angle / math.radians(vehicle.max_steering), pedal]


def of_metadrive(vehicle: Any, steering: float, throttle: float) -> tuple[float, float]:
    """Acceleration [m/s²] and front-wheel angle [rad] of MetaDrive's action."""
    acceleration = throttle * (ENGINE if throttle > 0 else BRAKES)
    return acceleration, -steering * math.radians(vehicle.max_steering)
