"""What it takes to be a mentor: one contract for machines, learned policies and people.

A mentor lives in the process of its environment and may look at everything the simulator knows,
which the learner may not. It is asked for an action only at steps where a switch needs one or
where the mentor is in control, at most once a step. A mentor must therefore not count its calls
as time steps; what it wants to know about the time it reads from the simulator.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, runtime_checkable

from tensordict import TensorDictBase
from torch import Tensor


@runtime_checkable
class Mentor(Protocol):
    """Someone or something that can take over.

    A machine computes its action from ``simulator``, a learned policy from ``tensordict``, and a
    person's device is read inside :meth:`act`, that is, when the action is applied and not one
    step earlier.
    """

    def reset(self, simulator: Any) -> None:
        """Forget the last episode. Called once at the start of each episode.

        Args:
            simulator: the unwrapped simulator behind the environment, already reset.
        """

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """Say what the mentor would do now.

        Args:
            simulator: the unwrapped simulator behind the environment.
            tensordict: the root entries of this step (``observation``, ...), no batch dimension.

        Returns:
            Action of shape ``[A]`` in the units of the agent's action (for driving ``[-1, 1]``,
            acceleration then steering).
        """
        ...


@runtime_checkable
class DensityMentor(Mentor, Protocol):
    """A mentor that can also say how likely it finds an action (for the probability switch)."""

    def density(self, simulator: Any, tensordict: TensorDictBase, action: Tensor) -> float:
        """Relative likelihood of ``action`` (shape ``[A]``) for this mentor, in ``[0, 1]``.

        1 stands for the action that the mentor itself would take. It is relative because a
        probability density over continuous actions has no fixed scale to hold a threshold to.
        """
        ...


@runtime_checkable
class RequestingMentor(Mentor, Protocol):
    """A mentor that decides by itself when it wants control, as a person at a wheel does."""

    def requests_control(self, simulator: Any, action_agent: Tensor) -> bool:
        """Whether the mentor wants control of this step; asked once a step, before :meth:`act`.

        Args:
            simulator: the unwrapped simulator behind the environment.
            action_agent: what the agent proposes, ``[A]``.
        """
        ...


@runtime_checkable
class ProposingMentor(Mentor, Protocol):
    """A mentor that speaks for the agent, too, as in a session that is driven again."""

    def before_reset(self, simulator: Any) -> None:
        """Make the episode that is about to be drawn the one that is wanted.

        Called before the simulator resets, perhaps more than once.
        """

    def proposal(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """What takes the place of the agent's action, shape ``[A]``.

        Called exactly once for each step, before the switch is asked.
        """
        ...


@runtime_checkable
class StatefulMentor(Mentor, Protocol):
    """A mentor that remembers something from episode to episode; a checkpoint keeps it."""

    def get_state(self) -> dict[str, Any]:
        """What it remembers: plain numbers, strings and tensors."""
        ...

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from there with a new episode."""


@runtime_checkable
class DeviceMentor(Mentor, Protocol):
    """A mentor who is read from a device, such as a person's wheel; sessions record this."""

    @property
    def device_ok(self) -> bool:
        """Whether the device works: connected, and heard of lately."""
        ...

    @property
    def latency_ms(self) -> float | None:
        """Delay of the input that the last step used [ms]; None if it is not known."""
        ...


MentorFactory: TypeAlias = Callable[[], Mentor]
"""Builds a mentor inside the worker that needs it. Classes and ``functools.partial`` objects do;
device handles and simulators do not travel between processes, and a factory need not carry any."""
