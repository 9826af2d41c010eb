"""What the suite has to know of a loss in order to ask everything of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.objectives import LossModule, ValueEstimators

from .networks import Networks

#: Our losses regress replayed single transitions: of TorchRL's estimators TD(0) alone fits.
ALL_BUT_TD0 = tuple(kind for kind in ValueEstimators if kind is not ValueEstimators.TD0)


@dataclass(frozen=True)
class Discounted:
    """A loss that regresses critics on a bootstrapped target y.

    Attributes:
        signal: entry under ``next`` that y sums up; None if y holds later values only.
        scale: the loss of a transition is ``scale * y**2`` where all critics are 0.
    """

    signal: str | None
    scale: float


@dataclass(frozen=True)
class LossCase:
    """A loss, and the facts about it that differ from loss to loss.

    Attributes:
        name: of the case.
        make: makes the loss of networks.
        losses: entries of the result that are losses.
        reads: entries of the batch that the loss reads.
        keys: every name that ``set_keys`` accepts, and its default. In a composite the name
            starts with the path of the module that has it, for instance ``terms.proxy.action``.
        trains: by loss, the starts of the names of all parameters that its gradient reaches.
            Empty for composites: tests/objectives/test_gradients.py has the map of the method.
        shares: networks whose parameters the loss shares instead of copying them.
        writes: priorities that the loss adds to the batch.
        leaves_behind: what else is found in the batch afterwards.
        targets: names of the target parameters.
        discounted: the losses that bootstrap.
        mean_over: by loss, which transitions a mean is taken over, bool ``[..., 1]``, where these
            are not all.
        draws: whether the result depends on random draws.
        ensemble: whether it has an ensemble of critics.
        error_of_reduction: what an unknown reduction raises.
        unsupported: value estimators that are refused.
        refused_gammas: discount factors that are refused.
        reset_copies_targets: whether targets equal what they follow after a reset of the
            parameters; else they are drawn by themselves.
        checks_critic: whether a critic that reads the action elsewhere is refused with the name
            of that entry.
        not_missed: entries read whose absence is not answered by a ``KeyError`` that names them.
        compiled: whether compilation is tried. It takes seconds, so each piece of code is compiled
            in one case.
    """

    name: str
    make: Callable[[Networks], LossModule]
    losses: tuple[str, ...]
    reads: frozenset[NestedKey]
    keys: Mapping[str, NestedKey]
    trains: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    shares: frozenset[str] = frozenset()
    writes: frozenset[NestedKey] = frozenset()
    leaves_behind: frozenset[NestedKey] = frozenset()
    targets: tuple[str, ...] = ()
    discounted: Mapping[str, Discounted] = field(default_factory=dict)
    mean_over: Mapping[str, Callable[[TensorDictBase], Tensor]] = field(default_factory=dict)
    draws: bool = True
    ensemble: bool = True
    error_of_reduction: type[Exception] = ValueError
    unsupported: tuple[ValueEstimators, ...] = ALL_BUT_TD0
    refused_gammas: tuple[float, ...] = (-0.1, 1.5)
    reset_copies_targets: bool = True
    checks_critic: bool = True
    not_missed: frozenset[NestedKey] = frozenset()
    compiled: bool = False

    def __str__(self) -> str:
        return self.name

    def counted(self, loss: str, batch: TensorDictBase) -> Tensor:
        """Which transitions of a batch ``[N]`` the mean of a loss is taken over, bool ``[N]``."""
        if loss not in self.mean_over:
            return torch.ones(batch.shape, dtype=torch.bool)
        return self.mean_over[loss](batch).squeeze(-1)

    def build(self, **options: Any) -> LossModule:
        """Makes the loss of fresh networks.

        Args:
            **options: of :class:`Networks`.
        """
        return self.build_of(Networks(**options))

    def build_of(self, networks: Networks) -> LossModule:
        """Makes the loss of given networks, always the same for the same seed."""
        with torch.random.fork_rng():
            torch.manual_seed(networks.seed)
            return self.make(networks)


def evaluate(loss: LossModule, batch: TensorDictBase, seed: int = 0) -> dict[str, Tensor]:
    """All entries of the result, computed with the draws of a seed.

    The batch is copied, so that priorities written to it do not show in the next call.
    """
    torch.manual_seed(seed)
    return dict(loss(batch.copy()).items())


def losses_of(result: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The entries that are losses."""
    return {name: value for name, value in result.items() if name.startswith("loss_")}


def total(result: Mapping[str, Tensor]) -> Tensor:
    """The sum of the losses, as an optimiser gets it."""
    return torch.stack(list(losses_of(result).values())).sum()


def gradients(loss: LossModule) -> dict[str, Tensor | None]:
    """The gradient of each parameter, where there is one."""
    return {name: parameter.grad for name, parameter in loss.named_parameters()}
