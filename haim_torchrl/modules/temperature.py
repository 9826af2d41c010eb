"""The entropy temperature alpha as a module of its own, so that several losses can share it."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn


class Temperature(nn.Module):
    """Entropy temperature α, kept as its logarithm so that it stays positive.

    The critic's target and the actor's loss read it, the temperature loss trains it: as a module
    it can be handed to all three. It is learned from a start value of 1, because the right scale
    depends on that of the proxy values, which no reward fixes; a constant is the alternative.

    Args:
        initial: start value, > 0.
        learnable: whether it is a parameter (auto-tuned) or a constant.

    Raises:
        ValueError: if ``initial`` is not positive.

    Examples:
        >>> Temperature(0.5, learnable=False)().item()
        0.5
    """

    log_alpha: Tensor

    def __init__(self, initial: float = 1.0, *, learnable: bool = True) -> None:
        super().__init__()
        if not initial > 0.0:
            raise ValueError(f"initial must be a positive temperature, got {initial}.")
        self.initial = float(initial)
        log_alpha = torch.tensor(math.log(initial))
        if learnable:
            self.log_alpha = nn.Parameter(log_alpha)
        else:
            self.register_buffer("log_alpha", log_alpha)

    @property
    def learnable(self) -> bool:
        """Whether a temperature loss can train it."""
        return isinstance(self.log_alpha, nn.Parameter)

    def forward(self) -> Tensor:
        """Returns α, a scalar without gradient: only the temperature loss may move it."""
        return self.log_alpha.detach().exp()

    def reset_parameters(self) -> None:
        """Sets α back to its start value."""
        with torch.no_grad():
            self.log_alpha.fill_(math.log(self.initial))


def as_temperature(value: Temperature | float) -> Temperature:
    """Takes a temperature as it is, and makes a constant one of a number."""
    if isinstance(value, Temperature):
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"temperature must be a Temperature or a number, got {value!r}.")
    return Temperature(float(value), learnable=False)
