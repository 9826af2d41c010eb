"""The person as a mentor: reads the console when the action is applied, and falls back safely."""

from __future__ import annotations

import time
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.human.console import Console
from haim_torchrl.human.controls import (
    Action,
    Feel,
    Reading,
    at_rest,
    steering_lock,
    towards,
    wants_control,
)
from haim_torchrl.mentors.protocol import Mentor


class Pause:
    """Fallback: nothing moves until the person is back."""


class Brake:
    """Fallback: brake to a standstill, steering straight.

    Args:
        braking: acceleration component of the action, in [-1, 0); -0.6 is 4.8 m/s² in the
            platoon's world, just short of a disturbance.
    """

    def __init__(self, braking: float = -0.6) -> None:
        if not -1.0 <= braking < 0.0:
            raise ValueError(f"braking is {braking}: it lies in [-1, 0).")
        self.braking = float(braking)

    def reset(self, simulator: Any) -> None:
        """Nothing to forget."""

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """The constant action, ``[2]``."""
        return torch.tensor([self.braking, 0.0])


class HumanMentor:
    """A person at a console takes over, with :class:`~haim_torchrl.switches.RequestSwitch`.

    The console is read when the step is taken, so that the freshest input is executed. The action
    moves smoothly from the agent's last one to what the person wishes, and back to the agent's
    when the controls are let go (:class:`~haim_torchrl.human.Feel`).

    A watchdog looks at the device in each step: unplugged, page closed, not heard of for
    ``stale_after`` during a takeover or for ``absent_after`` otherwise. Then ``fallback`` drives,
    or nothing moves, until the person is back, and ``device_ok`` is false.

    Args:
        console: window or page; opened at the first reset, in the process of the simulator.
        fallback: a mentor, or :class:`Pause`.
        feel: how the controls feel.
        stale_after: oldest input that a person in control may have [s].
        absent_after: longest silence of a person who only watches [s].
        settle: how long the device must work again before a pause ends [s].
        time_step: duration of a step [s].

    Raises:
        TypeError: if ``console`` or ``fallback`` is none.
        ValueError: if a time is not positive.
    """

    def __init__(
        self,
        console: Console,
        fallback: Mentor | Pause | None = None,
        *,
        feel: Feel | None = None,
        stale_after: float = 0.3,
        absent_after: float = 2.0,
        settle: float = 0.5,
        time_step: float = 0.1,
    ) -> None:
        if not isinstance(console, Console):
            raise TypeError(f"console is {type(console).__name__}, which is no console.")
        fallback = Pause() if fallback is None else fallback
        if not isinstance(fallback, Pause | Mentor):
            raise TypeError(
                f"fallback is {type(fallback).__name__}: give a mentor, such as ExpertMentor or "
                "Brake, or Pause."
            )
        for name, value in (
            ("stale_after", stale_after),
            ("absent_after", absent_after),
            ("time_step", time_step),
        ):
            if not value > 0.0:
                raise ValueError(f"{name} is {value}: it must be positive, in seconds.")
        self.console = console
        self.fallback = fallback
        self.feel = feel or Feel()
        self.stale_after = stale_after
        self.absent_after = absent_after
        self.settle = settle
        self.time_step = time_step
        self.reading = Reading()
        """What the person did at the last look."""
        self._ok = False
        self._met = False  # whether there ever was a person
        self._well_since: float | None = None
        self._driving = False
        self._returning = 0  # steps since the controls were let go
        self._command: Action = (0.0, 0.0)
        self._asked = False

    @property
    def device_ok(self) -> bool:
        """Whether the device worked at the last look."""
        return self._ok

    @property
    def falling_back(self) -> bool:
        """Whether, by the last look, another mentor must drive in the person's place."""
        return not self._ok and isinstance(self.fallback, Mentor)

    @property
    def latency_ms(self) -> float | None:
        """Delay of the input that the last step used [ms]."""
        return self.reading.latency_ms

    def reset(self, simulator: Any) -> None:
        """A new episode: the agent drives until the person asks for control."""
        self.console.open()
        if isinstance(self.fallback, Mentor):
            self.fallback.reset(simulator)
        self._driving, self._returning, self._asked = False, 0, False
        self._command = (0.0, 0.0)

    def hold(self) -> str | None:
        """Why nothing may move now, in a few words; None when it may.

        Before a person has come, while they pause, and, with :class:`Pause` as the fallback,
        while their device does not work.
        """
        self.look()
        self._asked = False  # a new step begins
        if self.reading.paused:
            return "paused"
        if not self._met:
            return self.reading.trouble or "waiting for a driver"
        if isinstance(self.fallback, Pause):
            if not self._ok:
                return self.reading.trouble or "connection lost: waiting for the driver"
            if self._well_since is not None:
                if time.monotonic() - self._well_since < self.settle:
                    return "the driver is back"
                self._well_since = None
        return None

    def look(self) -> Reading:
        """Read the console, and see whether the device works."""
        reading = self.console.read()
        patience = self.stale_after if self._driving else self.absent_after
        ok = reading.connected and reading.age <= patience
        if ok and not self._ok and self._met:
            self._well_since = time.monotonic()
        elif not ok:
            self._well_since = None
        self._ok = ok
        self._met = self._met or ok
        self.reading = reading
        return reading

    def requests_control(self, simulator: Any, action_agent: Tensor) -> bool:
        """Whether the person, or the fallback in their place, drives this step.

        Args:
            simulator: it is not looked at.
            action_agent: what the agent proposes, ``[2]``.
        """
        agent = _pair(action_agent)
        reading = self.look()
        self._asked = True
        if self.falling_back:
            self._driving = True
            return True
        controls = at_rest(reading.controls, reading.kind, self.feel)
        if self._ok and wants_control(controls, reading.kind, agent, self.feel):
            self._driving, self._returning = True, 0
        elif self._driving:
            # Let go: the command first moves to the agent's, or control would pass with a jump.
            self._returning += 1
            near = towards(self._command, agent, reading.kind, self.feel, self.time_step)
            self._driving = near != agent and self._returning <= self.feel.hand_back_steps
        if not self._driving:
            self._command, self._returning = agent, 0
        self._agent = agent
        return self._driving

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """The person's action, or the fallback's, ``[2]``."""
        if not (self._asked and self._driving):
            self.look()  # another switch gave control: the person was not asked, or did not want it
            self._asked = False
        if not self._ok and isinstance(self.fallback, Mentor):
            action = torch.as_tensor(self.fallback.act(simulator, tensordict))
            self._command, self._asked = _pair(action), False
            return action
        reading = self.reading
        if self._returning and self._asked:
            wish = self._agent
        else:
            controls = at_rest(reading.controls, reading.kind, self.feel)
            pedals, steering = controls.action
            lock = steering_lock(reading.kind, _speed(tensordict), self.feel)
            wish = (pedals, steering * lock)
        self._asked = False
        self._command = towards(self._command, wish, reading.kind, self.feel, self.time_step)
        return torch.tensor(self._command).clamp(-1.0, 1.0)


def _pair(action: Tensor) -> Action:
    acceleration, steering = action.tolist()
    return (acceleration, steering)


def _speed(tensordict: TensorDictBase) -> float:
    """The vehicle's speed where the environment tells it [m/s], else 0."""
    speed = tensordict.get("speed", None)
    return 0.0 if speed is None else float(speed)
