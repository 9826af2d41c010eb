"""What a hard brake of the AV costs the traffic behind it (eq. 20 and 21 of the paper).

:func:`disturbance_cost` predicts how much slower the followers will be, and
:func:`hard_brake_onset` says when that is charged. SI units throughout.
"""

from __future__ import annotations

from typing import Literal, get_args

import torch
from torch import Tensor

from haim_torchrl.traffic.car_following import CarFollowingModel, IDMParameters
from haim_torchrl.traffic.kernels import idm_constants, idm_mean_speed
from haim_torchrl.traffic.platoon import (
    DEFAULT_MODEL,
    as_platoon,
    check_max_speed,
    count_steps,
    rollout_platoon,
)

DisturbanceReference = Literal["counterfactual", "current", "literal"]
"""What the predicted speed of the followers is compared with: see :func:`disturbance_cost`."""

HARD_BRAKE_THRESHOLD = -5.0
"""The paper's lambda, m/s^2."""


def hard_brake(acceleration: Tensor, threshold: float = HARD_BRAKE_THRESHOLD) -> Tensor:
    """Whether the AV brakes hard: the paper's disturbance flag, whose share of steps is its rate.

    Args:
        acceleration: the AV's measured change of speed, any shape, m/s^2.
        threshold: lambda, m/s^2, negative.

    Returns:
        bool, same shape: ``acceleration <= threshold``.

    Raises:
        ValueError: if the threshold is not negative.
    """
    _check_threshold(threshold)
    return acceleration <= threshold


def hard_brake_onset(
    acceleration: Tensor,
    previous_acceleration: Tensor,
    threshold: float = HARD_BRAKE_THRESHOLD,
    *,
    literal: bool = False,
) -> Tensor:
    """When the disturbance cost is charged (eq. 21): at the first step of a hard brake.

    Eq. 21 as printed, ``acc_t >= lambda and acc_(t-1) < lambda``, holds at the step in which the
    brake is *released*: what is then held over the prediction is no brake any more. The text
    around it speaks of the onset of abrupt braking, so that is what counts here; the printed
    condition stays available.

    Args:
        acceleration: the AV's measured change of speed in this step, any shape, m/s^2.
        previous_acceleration: the same in the step before, m/s^2.
        threshold: lambda, m/s^2, negative.
        literal: use the condition as printed.

    Returns:
        bool, in the common shape.

    Raises:
        ValueError: if the threshold is not negative.
    """
    _check_threshold(threshold)
    if literal:
        return (acceleration >= threshold) & (previous_acceleration < threshold)
    return (acceleration <= threshold) & (previous_acceleration > threshold)


def mean_follower_speed(
    gaps: Tensor,
    speeds: Tensor,
    lead_speed: Tensor | float,
    lead_acceleration: Tensor | float,
    *,
    duration: float = 10.0,
    time_step: float = 0.1,
    hold: float | None = None,
    model: CarFollowingModel = DEFAULT_MODEL,
    max_speed: float = 15.0,
) -> Tensor:
    """Predicted mean speed of all followers over the next ``duration`` seconds (eq. 8).

    Eq. 8 sums over T / Delta t + 1 moments and divides by T, which is no mean speed: the sum is
    divided by the number of moments here, the given state being the first of them.

    IDM drivers on the CPU are predicted by a compiled loop, unless a gradient is asked for; the
    result is that of :func:`~haim_torchrl.traffic.platoon.rollout_platoon` within rounding.

    Args:
        gaps: [..., N], m.
        speeds: [..., N], m/s.
        lead_speed: [..., 1] or one number, m/s.
        lead_acceleration: [..., 1] or one number, m/s^2.
        duration: T, s.
        time_step: Delta t, s.
        hold: for how long the AV holds its acceleration, s; None is the whole duration.
        model: how the followers drive.
        max_speed: upper limit of every speed, m/s.

    Returns:
        [..., 1], m/s, on the device and of the floating-point type of ``gaps``.

    Raises:
        ValueError: if shapes or times do not fit.
    """
    gap, speed, lead, pulse = as_platoon(gaps, speeds, lead_speed, lead_acceleration)
    pulses = pulse.unsqueeze(0)
    return _mean_speeds(gap, speed, lead, pulses, duration, time_step, hold, model, max_speed)[0]


def disturbance_cost(
    gaps: Tensor,
    speeds: Tensor,
    lead_speed: Tensor | float,
    lead_acceleration: Tensor | float,
    *,
    reference: DisturbanceReference = "counterfactual",
    duration: float = 10.0,
    time_step: float = 0.1,
    hold: float | None = None,
    model: CarFollowingModel = DEFAULT_MODEL,
    max_speed: float = 15.0,
) -> Tensor:
    r"""Disturbance cost C^IM of the AV's acceleration in a given platoon (eq. 20).

    .. math:: C^{IM} = 1 - \exp(-\max(0, v_{ref} - v_{pred})) \in [0, 1)

    v_pred is the mean speed of the followers over the next ``duration`` seconds while the AV
    holds its acceleration (:func:`mean_follower_speed`). What it is compared with:

    - ``"counterfactual"``: the same prediction with a_AV = 0. Only the difference that the AV's
      action makes is charged, so followers that queue or close up anyway cost nothing.
    - ``"current"``: their present mean speed: eq. 20 with its sign repaired. Taken from the given
      state, which is known, instead of predicted one step ahead as in eq. 7.
    - ``"literal"``: eq. 20 as printed, ``1 - exp(-(v_pred - v_now))``. It *rewards* braking, and
      without bound: there to measure what the repair changes. The only one that can be negative.

    The cost is charged only at the onset of a hard brake (:func:`hard_brake_onset`, eq. 21);
    this function does not look at the threshold.

    With the acceleration held for all of T = 10 s, as in the paper, a hard brake at 10 m/s means
    a stop, and the cost is nearly 0 or nearly 1. A shorter ``hold`` grades it.

    Args:
        gaps: bumper-to-bumper gap of each follower to its predecessor, [..., N], m; the AV is the
            predecessor of follower 0.
        speeds: followers' speeds [..., N], m/s, in [0, ``max_speed``].
        lead_speed: the AV's speed, [..., 1] or one number, m/s.
        lead_acceleration: the AV's acceleration, [..., 1] or one number, m/s^2.
        reference: see above.
        duration: T, s, a multiple of ``time_step``.
        time_step: Delta t, s.
        hold: for how long the AV holds its acceleration, s; None is the whole duration.
        model: how the followers drive.
        max_speed: upper limit of every speed, m/s.

    Returns:
        [..., 1], no unit, on the device and of the floating-point type of ``gaps``; in [0, 1)
        unless the reference is literal.

    Raises:
        ValueError: if the reference is unknown, or shapes or times do not fit.

    Example:
        >>> gaps, speeds = torch.full((5,), 20.0), torch.full((5,), 10.0)
        >>> disturbance_cost(gaps, speeds, 10.0, -2.0) > disturbance_cost(gaps, speeds, 10.0, -1.0)
        tensor([True])
    """
    if reference not in get_args(DisturbanceReference):
        raise ValueError(
            f"reference must be one of {', '.join(get_args(DisturbanceReference))}, got "
            f"{reference!r}."
        )
    gap, speed, lead, pulse = as_platoon(gaps, speeds, lead_speed, lead_acceleration)
    pulses = pulse.unsqueeze(0)
    if reference == "counterfactual":
        pulses = torch.stack([pulse, torch.zeros_like(pulse)])
    means = _mean_speeds(gap, speed, lead, pulses, duration, time_step, hold, model, max_speed)
    predicted = means[0]
    compared = means[1] if reference == "counterfactual" else speed.mean(dim=-1, keepdim=True)
    change = predicted - compared
    if reference == "literal":
        return -torch.expm1(-change)
    below_one = 1.0 - 0.5 * torch.finfo(change.dtype).eps  # what rounding would make 1
    return torch.expm1(change.clamp(max=0.0)).abs().clamp(max=below_one)


def _check_threshold(threshold: float) -> None:
    if not threshold < 0:
        raise ValueError(
            f"threshold (lambda) must be a negative acceleration in m/s^2, got {threshold!r}."
        )


def _mean_speeds(
    gap: Tensor,
    speed: Tensor,
    lead: Tensor,
    pulses: Tensor,
    duration: float,
    time_step: float,
    hold: float | None,
    model: CarFollowingModel,
    max_speed: float,
) -> Tensor:
    """:func:`mean_follower_speed` of a checked state for P accelerations of the AV at once.

    ``pulses`` and the result are [P, ..., 1].
    """
    if not (isinstance(model, IDMParameters) and _compiled_loop_applies(gap, speed, lead, pulses)):
        trajectory = rollout_platoon(
            gap,
            speed,
            lead,
            pulses,
            duration=duration,
            time_step=time_step,
            hold=hold,
            model=model,
            max_speed=max_speed,
        )
        return trajectory.speeds.mean(dim=(-2, -1)).unsqueeze(-1)
    steps, held_steps = count_steps(duration, time_step, hold)
    check_max_speed(max_speed)
    followers = gap.shape[-1]
    means = idm_mean_speed(
        gap.reshape(-1, followers).numpy(force=True),
        speed.reshape(-1, followers).numpy(force=True),
        lead.reshape(-1).numpy(force=True),
        pulses.reshape(pulses.shape[0], -1).numpy(force=True),
        steps,
        held_steps,
        float(time_step),
        float(max_speed),
        idm_constants(model),
    )
    return torch.from_numpy(means).view(pulses.shape)


def _compiled_loop_applies(gap: Tensor, speed: Tensor, lead: Tensor, pulses: Tensor) -> bool:
    """Whether NumPy can see these tensors and nobody will ask for their gradient."""
    if not gap.is_cpu or gap.dtype not in (torch.float32, torch.float64):
        return False
    differentiated = gap.requires_grad or speed.requires_grad or lead.requires_grad
    if torch.is_grad_enabled() and (differentiated or pulses.requires_grad):
        return False
    return not torch.compiler.is_compiling()
