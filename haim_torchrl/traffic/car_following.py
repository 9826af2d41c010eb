"""Car-following models: how strongly a driver accelerates, given the vehicle in front.

Eq. 1 of the HAIM-DRL paper states what all of them share: the acceleration is a function of the
gap, of the relative speed and of the driver's own speed. :class:`CarFollowingModel` is that
statement as a type. A set of parameters is itself such a model, so that ``IDMParameters()`` and
``OVMParameters()`` can be handed to whatever asks for one, and so can a function of one's own.

All quantities are in SI units: m, m/s, m/s^2, s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Protocol

import torch
from torch import Tensor

MINIMUM_GAP = 0.1
"""Gap in m below which :func:`idm_acceleration` brakes no harder.

The interaction term is (s*/gap)^2, so without a floor two touching bumpers give an infinite
acceleration (and NaN gradients); at 0.1 m it is already far beyond what stops any vehicle within
one step, so the floor changes no trajectory.
"""

MINIMUM_DESIRED_SPEED = 0.1
"""Desired speed in m/s below which :func:`idm_acceleration` reads none.

The free-road term is (v/v0)^4; a driver who wants to stand (v0 = 0) is one who creeps at 0.1 m/s,
not a division by zero.
"""


class CarFollowingModel(Protocol):
    """Anything that maps a driver's situation to an acceleration (eq. 1).

    The three arguments broadcast against each other; the result has their common shape.
    """

    def __call__(self, speed: Tensor, gap: Tensor, lead_speed: Tensor) -> Tensor:
        """Return the acceleration in m/s^2.

        Args:
            speed: own speed in m/s, any shape.
            gap: bumper-to-bumper distance to the vehicle in front in m.
            lead_speed: speed of the vehicle in front in m/s.
        """
        ...


def _check(parameters: IDMParameters | OVMParameters, may_be_zero: tuple[str, ...]) -> None:
    """Raise a ValueError that names the first field which is no usable physical quantity."""
    for field in fields(parameters):
        value = getattr(parameters, field.name)
        name = f"{type(parameters).__name__}.{field.name}"
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise TypeError(f"{name} must be a number in SI units, got {value!r}.")
        smallest = "zero or more" if field.name in may_be_zero else "more than zero"
        allowed = value >= 0 if field.name in may_be_zero else value > 0
        if not (allowed and math.isfinite(value)):
            raise ValueError(f"{name} must be finite and {smallest} (SI units), got {value!r}.")


@dataclass(frozen=True)
class IDMParameters:
    """Parameters of the Intelligent Driver Model, and the model itself.

    The defaults are those of the paper's hyper-parameter table.

    Args:
        s0: gap kept at a standstill, m.
        time_headway: time gap kept while driving (T_h), s.
        max_acceleration: a, m/s^2.
        comfortable_deceleration: b as a positive number, m/s^2 (the paper's table prints -4).
        desired_speed: speed on a free road (v0), m/s; 0 is read as
            :data:`MINIMUM_DESIRED_SPEED`.
        exponent: exponent of the free-road term, at least 1 so that its derivative at a
            standstill exists.

    Raises:
        TypeError: if a field is no number.
        ValueError: if a field is negative, not finite, or zero where that has no meaning.

    Example:
        >>> driver = IDMParameters(time_headway=1.5)
        >>> driver(torch.tensor(0.0), torch.tensor(10.0), torch.tensor(0.0))
        tensor(3.)
    """

    s0: float = 5.0
    time_headway: float = 1.0
    max_acceleration: float = 4.0
    comfortable_deceleration: float = 4.0
    desired_speed: float = 15.0
    exponent: float = 4.0

    def __post_init__(self) -> None:
        _check(self, may_be_zero=("s0", "time_headway", "desired_speed"))
        if self.exponent < 1:
            raise ValueError(f"IDMParameters.exponent must be at least 1, got {self.exponent!r}.")

    def __call__(self, speed: Tensor, gap: Tensor, lead_speed: Tensor) -> Tensor:
        """:func:`idm_acceleration` under these parameters."""
        return idm_acceleration(speed, gap, lead_speed, self)


@dataclass(frozen=True)
class OVMParameters:
    """Parameters of the Optimal Velocity Model, and the model itself.

    The defaults are those common in studies of mixed platoons, with the standstill gap and the
    largest speed of the paper's vehicles. ``relative_speed_gain=0`` is the original model of
    Bando et al. (1995), which does not see how fast the vehicle in front is.

    Args:
        speed_gain: how fast the speed is pulled to the optimal one, 1/s.
        relative_speed_gain: how fast it is pulled to that of the vehicle in front, 1/s.
        stop_gap: gap at and below which the optimal speed is 0, m.
        go_gap: gap at and above which it is ``max_speed``, m.
        max_speed: m/s.

    Raises:
        TypeError: if a field is no number.
        ValueError: if a field is out of range, or ``go_gap`` does not exceed ``stop_gap``.
    """

    speed_gain: float = 0.6
    relative_speed_gain: float = 0.9
    stop_gap: float = 5.0
    go_gap: float = 35.0
    max_speed: float = 15.0

    def __post_init__(self) -> None:
        _check(self, may_be_zero=("relative_speed_gain", "stop_gap"))
        if self.go_gap <= self.stop_gap:
            raise ValueError(
                f"OVMParameters.go_gap must exceed stop_gap, got go_gap={self.go_gap!r} and "
                f"stop_gap={self.stop_gap!r}."
            )

    def __call__(self, speed: Tensor, gap: Tensor, lead_speed: Tensor) -> Tensor:
        """:func:`ovm_acceleration` under these parameters."""
        return ovm_acceleration(speed, gap, lead_speed, self)


_DEFAULT_IDM = IDMParameters()
_DEFAULT_OVM = OVMParameters()


def idm_acceleration(
    speed: Tensor | float,
    gap: Tensor | float,
    lead_speed: Tensor | float,
    params: IDMParameters = _DEFAULT_IDM,
) -> Tensor:
    r"""Acceleration of the Intelligent Driver Model (Treiber et al., 2000).

    .. math::
        s^* = s_0 + \max\left(0, v T_h + \frac{v (v - v_{lead})}{2\sqrt{ab}}\right), \quad
        acc = a \left(1 - (v / v_0)^4 - (s^* / gap)^2\right)

    The paper names the model and its parameters (table of hyper-parameters) but prints no
    formula; this is its usual form. The dynamic part of s* is kept from going negative, since a
    driver whose leader draws away would otherwise want less than the standstill gap, and with a
    negative s* even brake for it. The gap and the desired speed are kept away from zero
    (:data:`MINIMUM_GAP`, :data:`MINIMUM_DESIRED_SPEED`), so the result is always finite.
    It is differentiable in all three arguments.

    Args:
        speed: own speed v >= 0 in m/s, any shape.
        gap: bumper-to-bumper distance to the vehicle in front in m, any broadcastable shape.
        lead_speed: its speed in m/s, any broadcastable shape.
        params: the driver.

    Returns:
        The acceleration in m/s^2, in the common shape of the arguments. It has no lower bound:
        limit the speed, not the acceleration.
    """
    speed = torch.as_tensor(speed)
    gap = torch.as_tensor(gap).clamp(min=MINIMUM_GAP)
    approach = speed * (speed - lead_speed)
    root = 2.0 * math.sqrt(params.max_acceleration * params.comfortable_deceleration)
    desired_gap = params.s0 + (params.time_headway * speed + approach / root).clamp(min=0.0)
    desired_speed = max(params.desired_speed, MINIMUM_DESIRED_SPEED)
    free_road = (speed / desired_speed).clamp(min=0.0) ** params.exponent
    return params.max_acceleration * (1.0 - free_road - (desired_gap / gap) ** 2)


def ovm_acceleration(
    speed: Tensor | float,
    gap: Tensor | float,
    lead_speed: Tensor | float,
    params: OVMParameters = _DEFAULT_OVM,
) -> Tensor:
    r"""Acceleration of the Optimal Velocity Model (Bando et al., 1995).

    .. math::
        acc = k_v (V(gap) - v) + k_r (v_{lead} - v), \quad
        V(gap) = \frac{v_{max}}{2}
        \left(1 - \cos\left(\pi \, \frac{gap - g_{stop}}{g_{go} - g_{stop}}\right)\right)

    with the fraction limited to [0, 1]. It is the second model behind the interface of eq. 1,
    there to show that nothing else depends on the choice of the first. The range policy V is the
    one used in studies of mixed platoons; it needs no guard for small gaps, because it is flat
    there. Unlike the IDM the model does not promise to stop in time.

    Args:
        speed: own speed v >= 0 in m/s, any shape.
        gap: bumper-to-bumper distance to the vehicle in front in m, any broadcastable shape.
        lead_speed: its speed in m/s, any broadcastable shape.
        params: the driver.

    Returns:
        The acceleration in m/s^2, in the common shape of the arguments.
    """
    speed = torch.as_tensor(speed)
    span = params.go_gap - params.stop_gap
    fraction = ((torch.as_tensor(gap) - params.stop_gap) / span).clamp(0.0, 1.0)
    optimal_speed = 0.5 * params.max_speed * (1.0 - torch.cos(math.pi * fraction))
    return params.speed_gain * (optimal_speed - speed) + params.relative_speed_gain * (
        lead_speed - speed
    )
