"""What a person's hands and feet do, and how that becomes a smooth action."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Action: TypeAlias = tuple[float, float]
"""Acceleration and steering in [-1, 1], in the agent's units; steering is positive to the right."""

DeviceKind: TypeAlias = Literal["keys", "gamepad", "wheel"]
"""Keys are on or off (touch buttons, too); a gamepad's sticks spring back; a wheel may rest
anywhere."""


@dataclass(frozen=True, slots=True)
class Controls:
    """Positions of the controls.

    Attributes:
        steering: [-1, 1], positive to the right.
        throttle: [0, 1].
        brake: [0, 1].
        takeover: whether the key, button or paddle that takes over is held.
    """

    steering: float = 0.0
    throttle: float = 0.0
    brake: float = 0.0
    takeover: bool = False

    @property
    def action(self) -> Action:
        """The action wished for; the brake wins over the throttle, as in a car."""
        return (-self.brake if self.brake > 0.0 else self.throttle, self.steering)


RELEASED = Controls()
"""Nobody touches anything."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What a console knows of the person at one instant.

    Attributes:
        controls: positions of the controls, raw.
        kind: what they are.
        connected: whether there is a person's device at all: plugged in, page open.
        age: seconds since the device was last heard of.
        latency_ms: delay between hand and reading as far as it is known [ms].
        paused: whether the person has paused.
        quit: whether the person wants to stop the run.
        trouble: what the person can do about a device that is not connected, in a few words.
    """

    controls: Controls = RELEASED
    kind: DeviceKind = "keys"
    connected: bool = False
    age: float = 0.0
    latency_ms: float | None = None
    paused: bool = False
    quit: bool = False
    trouble: str = ""


@dataclass(frozen=True)
class Feel:
    """How controls feel.

    Attributes:
        dead_zone: what sticks, wheels and pedals show at rest, [0, 1); beyond it the range is
            stretched to the full one.
        engage: how far sticks and pedals must be moved to take over, (0, 1].
        opposite: how far steering must differ from the agent's, against it, to take over, (0, 2].
        steering_rate: fastest change of the steering by sticks and wheels [1/s].
        pedal_rate: fastest change of the acceleration [1/s].
        key_steering_rate: the same of the steering by keys [1/s].
        key_lock_speed: speed [m/s] up to which keys reach full steering; beyond it they reach
            ``(key_lock_speed / speed)²`` of it, which keeps the lateral acceleration.
        hand_back_steps: most steps for which the person's command moves to the agent's after the
            controls are let go, before the agent drives.
    """

    dead_zone: float = 0.05
    engage: float = 0.15
    opposite: float = 0.5
    steering_rate: float = 5.0
    pedal_rate: float = 10.0
    key_steering_rate: float = 2.5
    key_lock_speed: float = 6.5
    hand_back_steps: int = 5

    def __post_init__(self) -> None:
        if not 0.0 <= self.dead_zone < 1.0:
            raise ValueError(f"dead_zone is {self.dead_zone}: it lies in [0, 1).")
        for name in ("engage", "opposite", "steering_rate", "pedal_rate", "key_steering_rate",
                     "key_lock_speed"):  # fmt: skip
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} is {getattr(self, name)}: it must be positive.")
        if self.hand_back_steps < 0:
            raise ValueError(f"hand_back_steps is {self.hand_back_steps}: it cannot be negative.")


def without_dead_zone(value: float, zone: float) -> float:
    """An axis without its dead zone, in [-1, 1].

    Zero within ``[-zone, zone]``; beyond it linear, so that the ends stay where they are.

    Example:
        >>> without_dead_zone(0.05, 0.1), without_dead_zone(-1.0, 0.1), without_dead_zone(0.55, 0.1)
        (0.0, -1.0, 0.5)
    """
    size = min(max(abs(value) - zone, 0.0) / (1.0 - zone), 1.0)
    return round(size if value >= 0.0 else -size, 12) + 0.0


def at_rest(controls: Controls, kind: DeviceKind, feel: Feel) -> Controls:
    """The controls without what sensors show at rest; keys have no such thing."""
    if kind == "keys":
        return controls
    zone = feel.dead_zone
    return Controls(
        steering=without_dead_zone(controls.steering, zone),
        throttle=without_dead_zone(controls.throttle, zone),
        brake=without_dead_zone(controls.brake, zone),
        takeover=controls.takeover,
    )


def wants_control(controls: Controls, kind: DeviceKind, agent: Action, feel: Feel) -> bool:
    """Whether what the person does means "I drive".

    The takeover key does, and so do the pedals, drive keys and a stick that is moved. A wheel that
    rests somewhere does not, but one that is turned against the agent does.

    Args:
        controls: positions without dead zone.
        kind: what they are.
        agent: what the agent wants to do.
        feel: thresholds.
    """
    threshold = 0.0 if kind == "keys" else feel.engage
    if controls.takeover or controls.throttle > threshold or controls.brake > threshold:
        return True
    if kind != "wheel":
        return abs(controls.steering) > threshold
    against = controls.steering * agent[1] <= 0.0 and abs(controls.steering) > feel.engage
    return against and abs(controls.steering - agent[1]) > feel.opposite


def steering_lock(kind: DeviceKind, speed: float, feel: Feel) -> float:
    """Largest steering that keys reach at a speed [m/s]; 1 for what can be moved by degrees."""
    if kind != "keys" or speed <= feel.key_lock_speed:
        return 1.0
    return (feel.key_lock_speed / speed) ** 2


def towards(command: Action, wish: Action, kind: DeviceKind, feel: Feel, dt: float) -> Action:
    """The next command: as near to the wish as a smooth hand gets in ``dt`` seconds."""
    steering = feel.key_steering_rate if kind == "keys" else feel.steering_rate
    return (
        _approach(command[0], wish[0], feel.pedal_rate * dt),
        _approach(command[1], wish[1], steering * dt),
    )


def _approach(value: float, goal: float, step: float) -> float:
    return goal if abs(goal - value) <= step else value + (step if goal > value else -step)
