"""Definition 2 of the paper: take over when the agent's action strays from the mentor's."""

from __future__ import annotations

import math
from typing import Literal

from haim_torchrl.switches.protocol import Situation


class ActionSwitch:
    """Mentor controls when the two actions are further apart than ``threshold`` (eq. 5).

    Eq. 5 names the trigger only "takeover" and swaps its branches; the distance between the
    actions is what the text around it compares, and ``True`` stands for the mentor.

    Args:
        threshold: largest distance that leaves the agent in control, in units of the action.
        norm: ``"l2"``, Euclidean, or ``"linf"``, the largest difference in any dimension.

    Raises:
        ValueError: negative ``threshold`` or unknown ``norm``.
    """

    memoryless = True

    def __init__(self, threshold: float = 0.5, norm: Literal["l2", "linf"] = "l2") -> None:
        if not threshold >= 0.0:
            raise ValueError(f"threshold is {threshold}: a distance cannot be below 0.")
        if norm not in ("l2", "linf"):
            raise ValueError(f"norm is {norm!r}: choose 'l2' or 'linf'.")
        self.threshold = float(threshold)
        self.norm = norm

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, situation: Situation) -> bool:
        """``True`` when the actions are too far apart."""
        return self.distance(situation) > self.threshold

    def distance(self, situation: Situation) -> float:
        """Distance between the agent's and the mentor's action."""
        agent = situation.action_agent.tolist()
        mentor = situation.mentor_action().tolist()
        if self.norm == "l2":
            return math.dist(agent, mentor)
        return max(abs(a - m) for a, m in zip(agent, mentor))
