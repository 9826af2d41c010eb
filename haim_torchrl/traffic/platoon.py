"""Prediction of a platoon: one autonomous vehicle (AV) in front, N human drivers behind it.

The AV holds an acceleration, the drivers follow by a car-following model (assumption 3 of the
paper, eq. 8 and 9). Lengths of vehicles are left out, as in the paper: gaps run from bumper to
bumper. SI units throughout.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from haim_torchrl.traffic.car_following import CarFollowingModel, IDMParameters

DEFAULT_MODEL = IDMParameters()
"""The paper's drivers."""


class PlatoonTrajectory(NamedTuple):
    """A predicted platoon over ``steps`` time steps; follower 0 drives right behind the AV.

    Attributes:
        speeds: followers' speeds [..., steps + 1, N], m/s; the first is the given state.
        gaps: bumper-to-bumper gap of each follower to its predecessor [..., steps + 1, N], m.
        accelerations: followers' change of speed over each step [..., steps, N], m/s^2. This is
            what the vehicles did: where a speed ran into 0 or the limit it is less than what the
            model asked for.
        positions: followers' front bumpers [..., steps + 1, N], m, along the road, counted from
            where the AV's rear bumper was at the start.
        lead_speed: the AV's speed [..., steps + 1, 1], m/s.
        lead_position: way of the AV since the start [..., steps + 1, 1], m.
    """

    speeds: Tensor
    gaps: Tensor
    accelerations: Tensor
    positions: Tensor
    lead_speed: Tensor
    lead_position: Tensor


def count_steps(duration: float, time_step: float, hold: float | None) -> tuple[int, int]:
    """Number of time steps of a prediction, and of those in which the AV's acceleration is held.

    Args:
        duration: T in s, a multiple of ``time_step``.
        time_step: Delta t in s.
        hold: how long the AV's acceleration is held, in s, from 0 to ``duration``; None holds it
            throughout.

    Raises:
        ValueError: if one of them is out of range.
    """
    if not (math.isfinite(time_step) and time_step > 0):
        raise ValueError(f"time_step must be more than 0 s, got {time_step!r}.")
    steps = round(duration / time_step) if math.isfinite(duration) else 0
    if steps < 1 or abs(steps * time_step - duration) > 1e-6 * duration:
        raise ValueError(
            f"duration must be a multiple of time_step and at least one, got "
            f"duration={duration!r} s and time_step={time_step!r} s."
        )
    if hold is None:
        return steps, steps
    if not 0 <= hold <= duration:
        raise ValueError(
            f"hold must lie between 0 and duration={duration!r} s (None holds throughout), "
            f"got {hold!r}."
        )
    return steps, round(hold / time_step)


def check_max_speed(max_speed: float) -> None:
    """Raise a ValueError unless ``max_speed`` (m/s) is positive; ``math.inf`` is."""
    if not max_speed > 0:
        raise ValueError(f"max_speed must be more than 0 m/s, got {max_speed!r}.")


def as_platoon(
    gaps: Tensor, speeds: Tensor, lead_speed: Tensor | float, lead_acceleration: Tensor | float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Check the state of a platoon and give its parts one floating-point type and batch shape.

    Args:
        gaps: [..., N] in m.
        speeds: [..., N] in m/s.
        lead_speed: [..., 1] in m/s, or one number for all.
        lead_acceleration: [..., 1] in m/s^2, or one number for all.

    Returns:
        The four tensors: [..., N], [..., N], [..., 1] and [..., 1], all with the same batch shape
        (numbers on the device of ``gaps``; views, where a dimension was broadcast).

    Raises:
        ValueError: if the last dimensions are not N, N, 1 and 1.
    """
    if gaps.ndim == 0 or speeds.ndim == 0 or gaps.shape[-1] != speeds.shape[-1]:
        raise ValueError(
            f"gaps and speeds must both be [..., N] with the same N, got shapes "
            f"{tuple(gaps.shape)} and {tuple(speeds.shape)}."
        )
    if gaps.shape[-1] == 0:
        raise ValueError("gaps and speeds must hold at least one follower, got N = 0.")
    dtype = torch.promote_types(gaps.dtype, speeds.dtype)
    if not dtype.is_floating_point:
        dtype = torch.get_default_dtype()
    parts = [gaps, speeds]
    for name, lead in (("lead_speed", lead_speed), ("lead_acceleration", lead_acceleration)):
        if not isinstance(lead, Tensor) or lead.ndim == 0:
            lead = torch.as_tensor(lead, dtype=dtype, device=gaps.device).reshape(1)
        elif lead.shape[-1] != 1:
            raise ValueError(
                f"{name} must be a number or a tensor [..., 1], one value for each platoon, got "
                f"shape {tuple(lead.shape)}; add the last dimension with unsqueeze(-1)."
            )
        parts.append(lead)
    parts = [part if part.dtype == dtype else part.to(dtype) for part in parts]
    if len({part.shape[:-1] for part in parts}) > 1:
        batch = torch.broadcast_shapes(*(part.shape[:-1] for part in parts))
        parts = [part.expand(*batch, part.shape[-1]) for part in parts]
    return parts[0], parts[1], parts[2], parts[3]


def advance(
    speed: Tensor, acceleration: Tensor, time_step: float, max_speed: float
) -> tuple[Tensor, Tensor]:
    """Drive one time step at constant acceleration, standing still from where the speed gets to 0.

    The way is the ballistic one, (v + v') dt / 2. A vehicle that comes to rest within the step
    covers v^2 / (2 |acc|) and no more: with the ballistic way to the end of the step, queueing
    vehicles would creep into each other.

    Args:
        speed: v in m/s, in [0, ``max_speed``], any shape.
        acceleration: m/s^2, same shape.
        time_step: s.
        max_speed: m/s.

    Returns:
        The new speed in m/s, in [0, ``max_speed``], and the way in m, at least 0.
    """
    unlimited = speed + acceleration * time_step
    new_speed = unlimited.clamp(0.0, max_speed)
    smallest = torch.finfo(speed.dtype).tiny
    stopping_way = speed.square() / (-2.0 * acceleration).clamp(min=smallest)
    ballistic_way = (0.5 * time_step) * (speed + new_speed)
    return new_speed, torch.where(unlimited < 0.0, stopping_way, ballistic_way)


def _keep_apart(gap: Tensor, new_gap: Tensor) -> tuple[Tensor, Tensor]:
    """Hold back followers that would get into their predecessor during a step.

    A follower that lacks room is held back by what it lacks, and that much less room has the one
    behind it: h_i = max(0, h_(i-1) + lack_i), solved for all followers at once. Without contact h
    is exactly 0.

    Args:
        gap: [..., N] before the step, m.
        new_gap: [..., N] as the vehicles would drive freely, m.

    Returns:
        The gaps [..., N], none below 0 (or below ``gap``, where that was negative), and which
        followers touch, bool [..., N].
    """
    contact_gap = gap.clamp(max=0.0)
    total_lack = (contact_gap - new_gap).cumsum(dim=-1)
    held_back = total_lack - total_lack.cummin(dim=-1).values.clamp(max=0.0)
    held_back_ahead = torch.nn.functional.pad(held_back[..., :-1], (1, 0))
    return torch.maximum(new_gap + held_back - held_back_ahead, contact_gap), held_back > 0.0


def rollout_platoon(
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
) -> PlatoonTrajectory:
    """Predict a platoon whose leader holds its acceleration (eq. 9).

    All vehicles move at the same time: every acceleration is taken at the start of a step. Eq. 7
    of the paper adds an acceleration to a speed; here it is multiplied by the time step, as in
    eq. 9, since the units ask for it. Every vehicle's speed, the AV's too, stays in
    [0, ``max_speed``]: a held brake ends at a standstill, never in reverse.

    A standing vehicle does not move (see :func:`advance`), and one that runs into its predecessor
    stays behind it and takes over its speed: whatever the car-following model does, no gap gets
    below zero, or below its given value if that was negative.

    Differentiable in all tensor arguments (almost everywhere: a standing vehicle has gradient 0).

    Args:
        gaps: bumper-to-bumper gap of each follower to its predecessor, [..., N], m; the AV is the
            predecessor of follower 0.
        speeds: followers' speeds [..., N], m/s, in [0, ``max_speed``].
        lead_speed: the AV's speed, [..., 1] or one number, m/s.
        lead_acceleration: the AV's acceleration, [..., 1] or one number, m/s^2.
        duration: T in s, a multiple of ``time_step``; the paper's 10 s.
        time_step: Delta t in s.
        hold: for how many seconds the AV keeps ``lead_acceleration``; after that it keeps its
            speed. None is the whole duration (the paper's choice).
        model: how the followers drive.
        max_speed: upper limit of every speed, m/s; ``math.inf`` for none.

    Returns:
        The trajectory, with the broadcast batch shape of the four tensors.

    Raises:
        ValueError: if shapes or times do not fit.
    """
    steps, held_steps = count_steps(duration, time_step, hold)
    check_max_speed(max_speed)
    gap, speed, lead, pulse = as_platoon(gaps, speeds, lead_speed, lead_acceleration)
    lead_position, no_pulse = torch.zeros_like(lead), torch.zeros_like(pulse)
    vehicles = torch.cat([lead, speed], dim=-1)  # the AV first

    all_speeds, all_gaps, lead_positions = [vehicles], [gap], [lead_position]
    for step in range(steps):
        response = model(vehicles[..., 1:], gap, vehicles[..., :-1])
        acceleration = torch.cat([pulse if step < held_steps else no_pulse, response], dim=-1)
        vehicles, way = advance(vehicles, acceleration, time_step, max_speed)
        gap, touches = _keep_apart(gap, gap + way[..., :-1] - way[..., 1:])
        pushed_speed = torch.minimum(vehicles[..., 1:], vehicles[..., :-1])
        own_speed = torch.where(touches, pushed_speed, vehicles[..., 1:])
        vehicles = torch.cat([vehicles[..., :1], own_speed], dim=-1)
        lead_position = lead_position + way[..., :1]
        all_speeds.append(vehicles)
        all_gaps.append(gap)
        lead_positions.append(lead_position)

    speed_series = torch.stack(all_speeds, dim=-2)
    gap_series = torch.stack(all_gaps, dim=-2)
    lead_series = torch.stack(lead_positions, dim=-2)
    follower_speeds = speed_series[..., 1:]
    return PlatoonTrajectory(
        speeds=follower_speeds,
        gaps=gap_series,
        accelerations=follower_speeds.diff(dim=-2) / time_step,
        positions=lead_series - gap_series.cumsum(dim=-1),
        lead_speed=speed_series[..., :1],
        lead_position=lead_series,
    )
