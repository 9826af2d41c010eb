"""One optimisation step of a loss, and the guard against losses that are not finite."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.optim import Adam, Optimizer
from torchrl.objectives import LossModule

from haim_torchrl.objectives.composite import HAIMLoss, losses_of
from haim_torchrl.objectives.target import TargetUpdater


class NonFiniteLossError(FloatingPointError):
    """A loss is NaN or infinite; the parameters have not been touched by it.

    Attributes:
        name: the entry that is not finite.
    """

    def __init__(self, name: str, value: float) -> None:
        super().__init__(
            f"The entry {name!r} is {value}: training cannot go on; lower the learning rate or "
            "the preference's weight, or use the bounded preference."
        )
        self.name = name


def check_finite(losses: TensorDictBase) -> None:
    """Stops at a loss that is not finite, before it reaches the parameters.

    Args:
        losses: result of a loss module.

    Raises:
        NonFiniteLossError: names the first loss that is NaN or infinite.
    """
    names = losses_of(losses)
    values = [losses.get(name).detach() for name in names]
    if not torch.isfinite(sum(value.sum() for value in values)):
        for name, value in zip(names, values):
            bad = value[~torch.isfinite(value)]
            if bad.numel():
                raise NonFiniteLossError(name, bad.flatten()[0].item())


def make_optimizer(
    loss: LossModule,
    lr: float = 1e-4,
    *,
    fused: bool | None = True,
    overrides: Mapping[str, Mapping[str, Any]] | None = None,
    **options: Any,
) -> Adam:
    """Makes one Adam for all parameters of a loss, grouped by role.

    Args:
        loss: the loss.
        lr: learning rate (1e-4 in the paper).
        fused: one kernel for all parameters.
        overrides: by role (``actor``, ``critic``, ``temperature``), options that differ. In a loss
            of TorchRL's own the network ``actor_network`` is the actor, every other network a
            critic, and a parameter outside of networks the temperature.
        **options: of ``torch.optim.Adam``.

    Returns:
        The optimiser.

    Raises:
        ValueError: if an override names a role that the loss has not.
    """
    chosen = overrides or {}
    groups = (
        loss.parameter_groups(lr, **chosen)
        if isinstance(loss, HAIMLoss)
        else _network_groups(loss, lr, chosen)
    )
    return Adam(groups, lr=lr, fused=fused, **options)


class UpdateStep:
    """One gradient step: losses, one backward pass of their sum, optimiser, targets.

    Args:
        loss: the loss.
        optimizer: steps its parameters.
        target_updater: moves the targets, if the loss has any.
        max_grad_norm: clip the joint norm of each parameter group's gradient; ``None`` does not.

    Raises:
        ValueError: if ``max_grad_norm`` is not positive.
    """

    def __init__(
        self,
        loss: nn.Module,
        optimizer: Optimizer,
        target_updater: TargetUpdater | None = None,
        *,
        max_grad_norm: float | None = None,
    ) -> None:
        if max_grad_norm is not None and not max_grad_norm > 0.0:
            raise ValueError(f"max_grad_norm must be positive or None, got {max_grad_norm}.")
        self.loss = loss
        self.optimizer = optimizer
        self.target_updater = target_updater
        self.max_grad_norm = max_grad_norm

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Does one step.

        Args:
            batch: transitions.

        Returns:
            Losses and diagnostics, without gradient.

        Raises:
            NonFiniteLossError: if a loss is NaN or infinite; nothing has been changed then.
        """
        losses = self.loss(batch)
        check_finite(losses)
        total = _total(losses.get(name) for name in losses_of(losses))
        self.optimizer.zero_grad(set_to_none=True)
        total.backward()
        if self.max_grad_norm is not None:
            for group in self.optimizer.param_groups:
                nn.utils.clip_grad_norm_(group["params"], self.max_grad_norm)
        self.optimizer.step()
        if self.target_updater is not None:
            self.target_updater.step()
        return losses.detach()


def _network_groups(
    loss: LossModule, lr: float, overrides: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, Any]]:
    groups: dict[str, list[nn.Parameter]] = {}
    for name, parameter in loss.named_parameters():
        network, _, inside = name.partition(".")
        role = "temperature" if not inside else "critic"
        groups.setdefault("actor" if network == "actor_network_params" else role, []).append(
            parameter
        )
    unknown = sorted(set(overrides) - set(groups))
    if unknown:
        raise ValueError(f"No parameter has the role {unknown[0]!r}; roles are {sorted(groups)}.")
    return [
        {"params": parameters, "name": role, "lr": lr, **overrides.get(role, {})}
        for role, parameters in groups.items()
    ]


def _total(losses: Iterable[Tensor]) -> Tensor:
    return torch.stack(list(losses)).sum()
