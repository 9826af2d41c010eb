"""Going on from a saved state: what was learned comes back, what is set stays as it is set now."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Optimizer
from torchrl.objectives import LossModule
from torchrl.objectives.value import ValueEstimatorBase

from haim_torchrl.modules.temperature import Temperature


def load_learned(part: Any, state_dict: Any) -> None:
    """Restores a part of a run without the settings that were saved with it.

    A state holds settings, too: an optimiser's learning rates, and the discount, weights and bounds
    that losses keep as scalar buffers. Loaded as it is, it would train with the old ones in spite
    of new ones. Here all of these stay those that the part was made with.

    Args:
        part: an optimiser, a loss, or anything else with ``load_state_dict``.
        state_dict: its saved state.

    Raises:
        KeyError, RuntimeError, ValueError: as the part's own ``load_state_dict``.

    Examples:
        >>> def adam(lr: float) -> torch.optim.Adam:
        ...     return torch.optim.Adam(nn.Linear(2, 1).parameters(), lr=lr)
        >>> optimizer = adam(1e-4)
        >>> load_learned(optimizer, adam(1e-3).state_dict())
        >>> optimizer.param_groups[0]["lr"]
        0.0001
    """
    if isinstance(part, Optimizer):
        options = [
            {name: value for name, value in group.items() if name != "params"}
            for group in part.param_groups
        ]
        part.load_state_dict(state_dict)
        for group, kept in zip(part.param_groups, options, strict=True):
            group.update(kept)
        return
    part.state_dict()  # some losses of TorchRL make a setting only when they are asked for it
    settings = [(buffer, buffer.clone()) for buffer in _settings(part)]
    part.load_state_dict(state_dict)
    with torch.no_grad():
        for buffer, chosen in settings:
            buffer.copy_(chosen)


def _settings(part: Any) -> Iterator[Tensor]:
    """Scalars that no update changes: those are parameters, or belong to other modules."""
    if isinstance(part, nn.Module):
        for module in part.modules():
            if isinstance(module, LossModule | ValueEstimatorBase | Temperature):
                yield from (b for b in module.buffers(recurse=False) if not b.dim())
