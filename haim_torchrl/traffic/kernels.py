"""The disturbance predictor's inner loop, compiled.

:func:`idm_mean_speed` predicts a platoon of IDM drivers exactly as
:func:`haim_torchrl.traffic.platoon.rollout_platoon` does, but keeps only the mean speed. A torch
operation costs about as much as a hundred predicted vehicle steps, so for the few vehicles of a
platoon the compiled loop is some thousand times faster. Callers use it through
:func:`haim_torchrl.traffic.disturbance.disturbance_cost`; the two functions here are public for
simulators, which step IDM drivers on NumPy numbers. SI units.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from haim_torchrl.traffic.car_following import (
    MINIMUM_DESIRED_SPEED,
    MINIMUM_GAP,
    IDMParameters,
)

IDMConstants = tuple[float, float, float, float, float, float, float]


def idm_constants(params: IDMParameters) -> IDMConstants:
    """The parameters and guards as the compiled functions take them.

    The guards of :func:`~haim_torchrl.traffic.car_following.idm_acceleration` go along as
    arguments, because numba's cache would not notice a change of constants in another file.

    Returns:
        s0 (m), time headway (s), a (m/s^2), 1 / (2 sqrt(a b)) (s^2/m), 1 / v0 (s/m), exponent,
        smallest gap (m).
    """
    root = 2.0 * math.sqrt(params.max_acceleration * params.comfortable_deceleration)
    return (
        float(params.s0),
        float(params.time_headway),
        float(params.max_acceleration),
        1.0 / root,
        1.0 / max(params.desired_speed, MINIMUM_DESIRED_SPEED),
        float(params.exponent),
        MINIMUM_GAP,
    )


@njit(cache=True, error_model="numpy")
def idm_acceleration_scalar(
    speed: float, gap: float, lead_speed: float, constants: IDMConstants
) -> float:
    """:func:`~haim_torchrl.traffic.car_following.idm_acceleration` of one driver, compiled.

    Args:
        speed: m/s.
        gap: m.
        lead_speed: m/s.
        constants: from :func:`idm_constants`.

    Returns:
        The acceleration in m/s^2.
    """
    s0, time_headway, max_acceleration, inverse_root, inverse_v0, exponent, smallest_gap = constants
    dynamic_gap = speed * (time_headway + (speed - lead_speed) * inverse_root)
    interaction = (s0 + max(0.0, dynamic_gap)) / max(gap, smallest_gap)
    ratio = max(0.0, speed * inverse_v0)
    if exponent == 4.0:  # the usual case, without the slow power function
        ratio *= ratio
        free_road = ratio * ratio
    else:
        free_road = ratio**exponent
    return max_acceleration * (1.0 - free_road - interaction * interaction)


@njit(cache=True, error_model="numpy")
def idm_mean_speed(
    gaps: NDArray[np.floating],
    speeds: NDArray[np.floating],
    lead_speeds: NDArray[np.floating],
    lead_accelerations: NDArray[np.floating],
    steps: int,
    held_steps: int,
    time_step: float,
    max_speed: float,
    constants: IDMConstants,
) -> NDArray[np.floating]:
    """Mean speed of the followers over the prediction, the given state included (eq. 8).

    Args:
        gaps: [B, N], m.
        speeds: [B, N], m/s.
        lead_speeds: [B], m/s.
        lead_accelerations: [P, B], m/s^2: P predictions for each platoon.
        steps: number of time steps.
        held_steps: in how many of them the AV holds its acceleration.
        time_step: s.
        max_speed: upper limit of all speeds, m/s.
        constants: from :func:`idm_constants`.

    Returns:
        [P, B], m/s, of the type of ``gaps``; summed in double precision.
    """
    predictions, platoons = lead_accelerations.shape
    followers = gaps.shape[1]
    mean_speeds = np.empty((predictions, platoons), dtype=gaps.dtype)
    gap = np.empty(followers)
    speed = np.empty(followers + 1)  # the AV first
    new_speed = np.empty(followers + 1)
    touches = np.zeros(followers, dtype=np.bool_)
    for index in range(predictions * platoons):
        prediction, platoon = divmod(index, platoons)
        speed[0] = lead_speeds[platoon]
        total = 0.0
        for i in range(followers):
            gap[i] = gaps[platoon, i]
            speed[i + 1] = speeds[platoon, i]
            total += speed[i + 1]
        for step in range(steps):
            way_ahead = 0.0
            for i in range(followers + 1):
                if i > 0:
                    acceleration = idm_acceleration_scalar(
                        speed[i], gap[i - 1], speed[i - 1], constants
                    )
                elif step < held_steps:
                    acceleration = float(lead_accelerations[prediction, platoon])
                else:
                    acceleration = 0.0
                unlimited = speed[i] + acceleration * time_step
                if unlimited < 0.0:  # comes to rest within the step
                    new_speed[i] = 0.0
                    way = speed[i] * speed[i] / (-2.0 * acceleration)
                else:
                    new_speed[i] = min(unlimited, max_speed)
                    way = 0.5 * time_step * (speed[i] + new_speed[i])
                if i > 0:
                    contact_gap = min(gap[i - 1], 0.0)
                    gap[i - 1] += way_ahead - way
                    touches[i - 1] = gap[i - 1] < contact_gap
                    if touches[i - 1]:  # held back by the predecessor
                        way -= contact_gap - gap[i - 1]
                        gap[i - 1] = contact_gap
                way_ahead = way
            speed[0] = new_speed[0]
            for i in range(1, followers + 1):
                speed[i] = min(new_speed[i], new_speed[i - 1]) if touches[i - 1] else new_speed[i]
                total += speed[i]
        mean_speeds[prediction, platoon] = total / (followers * (steps + 1))
    return mean_speeds
