"""From what a device's axes and buttons report to the positions of the controls.

Pads and wheels agree on little: pedals rest at -1, 0 or +1 and move either way, two pedals may
share one axis, and a wheel's middle need not be 0. All of it is covered by two numbers a pedal,
where it rests and where it ends, and three for the steering.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from haim_torchrl.human.controls import Controls

SHORTEST = 0.1
"""Least travel of an axis from rest to end, of the 2 that it reports at most."""


def travelled(raw: float, rest: float, end: float) -> float:
    """How far an axis is from its rest to its end, in [0, 1].

    Example:
        >>> travelled(1.0, 1.0, -1.0), travelled(0.0, 1.0, -1.0), travelled(-1.2, 1.0, -1.0)
        (0.0, 0.5, 1.0)
    """
    return min(max((raw - rest) / (end - rest), 0.0), 1.0) + 0.0


@dataclass(frozen=True, slots=True)
class Steering:
    """The axis that steers.

    Attributes:
        axis: its number.
        left: what it reports fully left.
        centre: what it reports in the middle, between the two.
        right: what it reports fully right.
    """

    axis: int
    left: float = -1.0
    centre: float = 0.0
    right: float = 1.0

    def __post_init__(self) -> None:
        _check_index("axis", self.axis)
        one, other = self.left - self.centre, self.right - self.centre
        if min(abs(one), abs(other)) < SHORTEST or one * other > 0.0:
            raise ValueError(
                f"centre is {self.centre}: it lies between left ({self.left}) and right "
                f"({self.right}), at least {SHORTEST} from both."
            )

    def read(self, axes: Sequence[float | None]) -> float:
        """Steering in [-1, 1], positive to the right; 0 where the axis is silent or missing."""
        raw = _value(axes, self.axis)
        if raw is None:
            return 0.0
        right = travelled(raw, self.centre, self.right)
        return right - travelled(raw, self.centre, self.left)


@dataclass(frozen=True, slots=True)
class Pedal:
    """A pedal, trigger or half of a stick.

    Attributes:
        axis: its number; throttle and brake may share one that rests between their ends.
        rest: what it reports untouched.
        end: what it reports fully pressed.
    """

    axis: int
    rest: float = -1.0
    end: float = 1.0

    def __post_init__(self) -> None:
        _check_index("axis", self.axis)
        if abs(self.end - self.rest) < SHORTEST:
            raise ValueError(
                f"end is {self.end}: it lies at least {SHORTEST} from rest ({self.rest})."
            )

    def read(self, axes: Sequence[float | None], buttons: Collection[int]) -> float:
        """Position in [0, 1]; 0 where the axis is silent or missing."""
        raw = _value(axes, self.axis)
        return 0.0 if raw is None else travelled(raw, self.rest, self.end)


@dataclass(frozen=True, slots=True)
class PedalButton:
    """A pedal that is a button: pressed or not."""

    button: int

    def __post_init__(self) -> None:
        _check_index("button", self.button)

    def read(self, axes: Sequence[float | None], buttons: Collection[int]) -> float:
        """0 or 1."""
        return float(self.button in buttons)


@dataclass(frozen=True, slots=True)
class Mapping:
    """Which axes and buttons of a device do what.

    Attributes:
        kind: a pad, whose sticks spring back, or a wheel.
        steering: the axis that steers.
        throttle: the right pedal or trigger.
        brake: the left one.
        takeover: buttons or paddles that take over while held.
        pause: buttons that pause and go on.
    """

    kind: Literal["gamepad", "wheel"]
    steering: Steering
    throttle: Pedal | PedalButton
    brake: Pedal | PedalButton
    takeover: tuple[int, ...] = ()
    pause: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        for name in ("takeover", "pause"):
            for button in getattr(self, name):
                _check_index(name, button)

    def read(self, axes: Sequence[float | None], buttons: Collection[int]) -> Controls:
        """Positions of the controls.

        Args:
            axes: what the axes report, about -1 to 1; None for one that has been silent so far.
            buttons: numbers of those held.
        """
        return Controls(
            steering=self.steering.read(axes),
            throttle=self.throttle.read(axes, buttons),
            brake=self.brake.read(axes, buttons),
            takeover=not set(self.takeover).isdisjoint(buttons),
        )


def facing(mapping: Mapping, axes: Sequence[float | None]) -> Mapping:
    """The mapping for a device that nobody touches: its pedals the right way round.

    Drivers of the same wheel differ in which end of a pedal is which. Throttle and brake that are
    both fully pressed in the moment when the device is opened are two pedals at rest.
    """
    throttle, brake = mapping.throttle, mapping.brake
    if not isinstance(throttle, Pedal) or not isinstance(brake, Pedal):
        return mapping
    if throttle.axis == brake.axis or min(p.read(axes, ()) for p in (throttle, brake)) < 0.95:
        return mapping
    return replace(
        mapping,
        throttle=replace(throttle, rest=throttle.end, end=throttle.rest),
        brake=replace(brake, rest=brake.end, end=brake.rest),
    )


def _value(axes: Sequence[float | None], index: int) -> float | None:
    return axes[index] if index < len(axes) else None


def _check_index(name: str, index: int) -> None:
    if isinstance(index, bool) or not isinstance(index, int) or index < 0:
        raise ValueError(f"{name} is {index!r}: it is a number of the device, from 0.")
