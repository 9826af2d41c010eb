"""A mentor that makes mistakes, as a person does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.mentors.protocol import Mentor, StatefulMentor
from haim_torchrl.mentors.stream import EpisodeStream


class FallibleMentor:
    """Another mentor with an unsteady hand that slips now and then (ε of the paper's assumption 1).

    Each action is the other mentor's with normal noise. With probability ``rate`` a slip begins
    instead: an action drawn uniformly from [-1, 1]^A, kept for ``steps`` actions.

    Draws come from a generator of its own (:class:`~haim_torchrl.mentors.stream.EpisodeStream`),
    so that exploration and learning draw the same whether this mentor drives, or a session of it
    is driven again. They follow from ``seed`` and from the simulator's generator at the start of
    the episode: a seeded run repeats them, workers differ, and a run that is gone on with from a
    checkpoint draws what it would have drawn.

    Args:
        mentor: who would drive without mistakes, in actions within [-1, 1].
        rate: probability that an action begins a slip, in [0, 1].
        steps: length of a slip in actions.
        noise: standard deviation of the unsteady hand, in units of the action.
        seed: of its draws.

    Raises:
        TypeError: if ``mentor`` is none.
        ValueError: if the rate is no probability, a slip has no length, or the noise or the seed
            is negative.
    """

    def __init__(
        self,
        mentor: Mentor,
        *,
        rate: float = 0.01,
        steps: int = 5,
        noise: float = 0.05,
        seed: int = 0,
    ) -> None:
        if not isinstance(mentor, Mentor):
            raise TypeError(
                f"mentor is {type(mentor).__name__}, which lacks reset(simulator) or "
                "act(simulator, tensordict)."
            )
        if not 0.0 <= rate <= 1.0:
            raise ValueError(f"rate is {rate}: the probability of a slip lies in [0, 1].")
        if steps < 1 or not noise >= 0.0:
            raise ValueError(
                f"steps is {steps} and noise {noise}: a slip lasts for at least 1 action, and the "
                "noise is 0 or more."
            )
        self.mentor = mentor
        self.rate = float(rate)
        self.steps = int(steps)
        self.noise = float(noise)
        self._stream = EpisodeStream(seed, "slips")
        self._slip: Tensor | None = None
        self._left = 0

    def reset(self, simulator: Any) -> None:
        """Recover, and let the other mentor forget the last episode."""
        self.mentor.reset(simulator)
        self._stream.reset()
        self._left = 0

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """The other mentor's action with its noise, or a slip, shape ``[A]``."""
        action = torch.as_tensor(self.mentor.act(simulator, tensordict))
        generator = self._stream.generator(simulator)
        if self._left == 0 and torch.rand((), generator=generator) < self.rate:
            self._slip = 2.0 * _draw(torch.rand, action, generator) - 1.0
            self._left = self.steps
        if self._left and self._slip is not None:
            self._left -= 1
            return self._slip
        noise = _draw(torch.randn, action, generator)
        return (action + self.noise * noise).clamp(-1.0, 1.0)

    def get_state(self) -> dict[str, Any]:
        """What its draws, and the other mentor, remember from episode to episode."""
        state: dict[str, Any] = {"stream": self._stream.get_state()}
        if isinstance(self.mentor, StatefulMentor):
            state["mentor"] = self.mentor.get_state()
        return state

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from there with a new episode."""
        self._stream.set_state(state["stream"])
        self._left = 0
        if isinstance(self.mentor, StatefulMentor):
            self.mentor.set_state(state["mentor"])


def _draw(function: Callable[..., Tensor], like: Tensor, generator: torch.Generator) -> Tensor:
    return function(like.shape, generator=generator, dtype=like.dtype).to(like.device)
