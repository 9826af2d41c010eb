"""The average of a policy over training: steadier than the policy of any one moment."""

from __future__ import annotations

from typing import Any

from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn


class PolicyAverage:
    """Exponential moving average of a policy's parameters.

    A policy that follows critics which still move drives well at one checkpoint and badly at the
    next. Its average over the last updates is what drives: it proposes actions in training, and is
    validated, kept and evaluated.

    Args:
        actor: The policy that is trained.
        decay: Share of the average that an update keeps, in [0, 1); 0.999 averages over about a
            thousand updates, 0 is the policy itself.

    Raises:
        ValueError: If the decay is outside [0, 1).
    """

    def __init__(self, actor: nn.Module, decay: float = 0.999) -> None:
        if not 0.0 <= decay < 1.0:
            raise ValueError(f"decay of the policy's average must be in [0, 1); got {decay}")
        self._trained = actor
        average = get_ema_multi_avg_fn(decay)
        # An encoder that a critic trains is a buffer of the actor; it goes with the rest.
        self._average = AveragedModel(actor, multi_avg_fn=average, use_buffers=True)

    @property
    def actor(self) -> Any:
        """The average as a policy of its own."""
        return self._average.module

    def update(self) -> None:
        """Take in the policy's present parameters. Call after each update."""
        self._average.update_parameters(self._trained)

    def state_dict(self) -> dict[str, Any]:
        """The average and how many updates are in it."""
        return self._average.state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue from a saved average."""
        self._average.load_state_dict(state_dict)
