"""A mentor's watchfulness: dangers that are overlooked."""

from __future__ import annotations

import torch

from haim_torchrl.switches.protocol import Situation, Switch


class Lapse:
    """Overlooks what should make the mentor take over (κ of the paper's assumption 2).

    On each step on which ``switch`` fires while the agent drives, attention lapses with
    probability ``rate``, and then nothing is noticed for ``steps`` steps. The paper's κ is that
    of single steps (``steps=1``); a person who looks away misses more than a tenth of a second.
    Who is in control does not lapse. Draws come from torch's generator, as exploration does, so
    that a seeded run repeats itself.

    Args:
        switch: what should trigger.
        rate: probability of a lapse, in [0, 1].
        steps: length of a lapse in environment steps.

    Raises:
        ValueError: if the rate is no probability, or a lapse has no length.
    """

    memoryless = False

    def __init__(self, switch: Switch, rate: float = 0.1, steps: int = 10) -> None:
        if not 0.0 <= rate <= 1.0:
            raise ValueError(f"rate is {rate}: the probability of a lapse lies in [0, 1].")
        if steps < 1:
            raise ValueError(f"steps is {steps}: a lapse lasts for at least 1 step.")
        self.switch = switch
        self.rate = float(rate)
        self.steps = int(steps)
        self._left = 0

    def reset(self) -> None:
        """Be attentive and reset the trigger."""
        self.switch.reset()
        self._left = 0

    def __call__(self, situation: Situation) -> bool:
        """``True`` where ``switch`` fires and is noticed."""
        fires = self.switch(situation)
        if self._left:
            self._left -= 1
            return False
        if not fires or situation.was_intervening:
            return bool(fires)
        if torch.rand(()) < self.rate:
            self._left = self.steps - 1
            return False
        return True
