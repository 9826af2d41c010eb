"""Slowly moving targets, all updated by one fused operation."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from tensordict.nn import TensorDictParams
from torch import Tensor
from torchrl.objectives import LossModule

from haim_torchrl.objectives.networks import leaf_names, leaves

PREFIX = "target_"


class TargetUpdater:
    r"""Polyak averaging, :math:`\theta' \leftarrow \theta' + \tau (\theta - \theta')`.

    TorchRL's ``SoftUpdate`` serves one loss module whose targets are its direct children. This
    one finds the targets of a loss and of all losses inside it, and moves all their tensors in
    one fused operation.

    Args:
        loss: a loss module.
        tau: share of the online parameters mixed in at each step, in (0, 1].

    Raises:
        ValueError: if tau is out of range, or there are no targets.

    Examples:
        >>> from haim_torchrl.modules import make_actor, make_critic
        >>> from haim_torchrl.objectives import ProxyQLoss
        >>> updater = TargetUpdater(ProxyQLoss(make_actor(3, 2), make_critic(3, 2)), tau=0.005)
        >>> updater.step()
    """

    def __init__(self, loss: LossModule, tau: float = 0.005) -> None:
        if not 0.0 < tau <= 1.0:
            raise ValueError(f"tau must lie in (0, 1], got {tau}.")
        self.loss = loss
        self.tau = float(tau)
        self._pairs = list(_find_targets(loss))
        if not self._pairs:
            raise ValueError(f"{type(loss).__name__} has no target parameters to update.")
        for module in loss.modules():
            if isinstance(module, LossModule):
                for name in module._has_update_associated:
                    module._has_update_associated[name] = True

    @torch.no_grad()
    def step(self) -> None:
        """Moves all targets a step towards the online parameters."""
        targets: list[Tensor] = []
        sources: list[Tensor] = []
        for target, source, names in self._pairs:
            targets += leaves(target, names)
            sources += leaves(source, names)
        torch._foreach_lerp_(targets, sources, self.tau)


def _find_targets(
    loss: LossModule,
) -> Iterator[tuple[TensorDictParams, TensorDictParams, list[str]]]:
    """Targets, what they follow, and the names of their tensors; each target once."""
    for module in loss.modules():
        if isinstance(module, LossModule):
            for name, child in module.named_children():
                if name.startswith(PREFIX) and isinstance(child, TensorDictParams):
                    source = module.get_submodule(name[len(PREFIX) :])
                    yield child, source, leaf_names(child)
