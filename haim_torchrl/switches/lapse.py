"""A mentor's watchfulness: dangers that are overlooked."""

from __future__ import annotations

import torch

from haim_torchrl.mentors.stream import EpisodeStream
from haim_torchrl.switches.protocol import Situation, Switch


class Lapse:
    """Overlooks what should make the mentor take over (κ of the paper's assumption 2).

    On each step on which ``switch`` fires while the agent drives, attention lapses with
    probability ``rate``, and then nothing is noticed for ``steps`` steps. The paper's κ is that
    of single steps (``steps=1``); a person who looks away misses more than a tenth of a second.
    Who is in control does not lapse.

    Draws come from a generator of its own (:class:`~haim_torchrl.mentors.stream.EpisodeStream`),
    so that exploration and learning draw the same whether there are lapses, or a session of them
    is driven again. They follow from ``seed`` and from the simulator's generator at the start of
    the episode: a seeded run repeats them and workers differ. A run that is gone on with from a
    checkpoint draws what it would have drawn, as far as resets draw from the simulator's generator;
    where they do not, its lapses are those of a run's start.

    Args:
        switch: what should trigger.
        rate: probability of a lapse, in [0, 1].
        steps: length of a lapse in environment steps.
        seed: of its draws.

    Raises:
        ValueError: if the rate is no probability, a lapse has no length, or the seed is negative.
    """

    memoryless = False

    def __init__(
        self, switch: Switch, rate: float = 0.1, steps: int = 10, *, seed: int = 0
    ) -> None:
        if not 0.0 <= rate <= 1.0:
            raise ValueError(f"rate is {rate}: the probability of a lapse lies in [0, 1].")
        if steps < 1:
            raise ValueError(f"steps is {steps}: a lapse lasts for at least 1 step.")
        self.switch = switch
        self.rate = float(rate)
        self.steps = int(steps)
        self._stream = EpisodeStream(seed, "lapses")
        self._left = 0

    def reset(self) -> None:
        """Be attentive and reset the trigger."""
        self.switch.reset()
        self._stream.reset()
        self._left = 0

    def __call__(self, situation: Situation) -> bool:
        """``True`` where ``switch`` fires and is noticed."""
        fires = self.switch(situation)
        if self._left:
            self._left -= 1
            return False
        if not fires or situation.was_intervening:
            return bool(fires)
        generator = self._stream.generator(situation.simulator)
        if torch.rand((), generator=generator) < self.rate:
            self._left = self.steps - 1
            return False
        return True
