"""What it takes to be a switch: decide, once a step, whether the mentor controls the step.

The switch is asked before the simulator steps (the paper's Algorithm 2 steps once with the agent's
action and then again with the mentor's; here the decision comes first, so that each transition
holds the one action that was executed). ``True`` means that the mentor controls: the paper's
eq. 5 and its appendix swap the two branches, and only this reading fits
``action = I * action_mentor + (1 - I) * action_agent``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.mentors.protocol import Mentor


class Situation:
    """All a switch may look at when it decides on one step.

    Attributes:
        simulator: the unwrapped simulator behind the environment.
        tensordict: the root entries of the step (``observation``, ...), no batch dimension.
        action_agent: what the agent proposes, shape ``[A]``, on the CPU and without gradient.
        mentor: who would take over.
        was_intervening: whether the mentor controlled the step before (``False`` at a reset).
    """

    __slots__ = (
        "_mentor_action",
        "_read_mentor",
        "action_agent",
        "mentor",
        "simulator",
        "tensordict",
        "was_intervening",
    )

    def __init__(
        self,
        simulator: Any,
        tensordict: TensorDictBase,
        action_agent: Tensor,
        mentor: Mentor,
        was_intervening: bool,
        read_mentor: Callable[[Any, TensorDictBase], Tensor] | None = None,
    ) -> None:
        self.simulator = simulator
        self.tensordict = tensordict
        self.action_agent = action_agent
        self.mentor = mentor
        self.was_intervening = was_intervening
        self._read_mentor = mentor.act if read_mentor is None else read_mentor
        self._mentor_action: Tensor | None = None

    def mentor_action(self) -> Tensor:
        """What the mentor would do now, shape ``[A]``.

        Computed at the first call and kept for the step, so that a switch that needs no mentor
        does not pay for one, and the action judged is the action executed.
        """
        if self._mentor_action is None:
            self._mentor_action = self._read_mentor(self.simulator, self.tensordict)
        return self._mentor_action


@runtime_checkable
class Switch(Protocol):
    """Decides who controls a step."""

    def reset(self) -> None:
        """Forget the last episode. Called once at the start of each episode."""

    def __call__(self, situation: Situation) -> bool:
        """``True`` when the mentor is to control this step."""
        ...


SwitchFactory: TypeAlias = Callable[[], Switch]
"""Builds a switch. Switches may have memory, so each environment needs its own."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """What a simulator expects if the agent's action is carried out.

    The manoeuvre is the agent's action for a short while and then firm braking to a standstill
    (the simulator's settings say how long and how firm; by default 1 s and 5 m/s²): as
    long as that stays safe, nobody has to act yet.

    Attributes:
        collision: whether the manoeuvre ends in a collision.
        departure: whether it leaves the road.
        time_to_collision: seconds until that collision, ``inf`` without one.
        time_to_departure: seconds until the road is left, ``inf`` if it is not.
        lateral_acceleration: magnitude of the largest lateral acceleration, m/s².
        clearance: least distance between the road's edge and the vehicle's centre while the action
            is held, m; ``inf`` where there is no road.
        stalled_steps: steps of crawling or standing without cause, up to now.
    """

    collision: bool = False
    departure: bool = False
    time_to_collision: float = math.inf
    time_to_departure: float = math.inf
    lateral_acceleration: float = 0.0
    clearance: float = math.inf
    stalled_steps: int = 0


@runtime_checkable
class Forecasting(Protocol):
    """A simulator that can tell where an action leads."""

    def forecast(self, action: np.ndarray) -> Forecast:
        """Forecast for the agent's ``action`` (shape ``[A]``) without changing the simulation."""
        ...
