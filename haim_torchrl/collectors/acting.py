"""The agent's policy as a collector calls it: one observation at a time, action only."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    TensorDictModule,
    TensorDictModuleBase,
    TensorDictSequential,
)
from torch import Tensor
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import TanhNormal


class ActingPolicy(TensorDictModuleBase):
    """Acts like a squashed Gaussian actor, without building a distribution for every step.

    One step of a simulator needs one action. The general way to it (modules writing parameters,
    a distribution object, checks) costs several times what the network itself does. This module
    runs the network of ``actor`` on the same parameters and draws from the same distribution,
    bit for bit with the same random numbers, and writes nothing but the action, so that replay
    holds no stale ``loc`` and ``scale``. Deterministic under ``ExplorationType.DETERMINISTIC``,
    ``MEAN`` and ``MODE``.

    Use :func:`as_acting_policy`, which says whether an actor can be run this way.

    Args:
        actor: a ``ProbabilisticActor`` of one network that writes ``loc`` and ``scale``, and a
            ``TanhNormal``.
    """

    def __init__(self, actor: TensorDictSequential) -> None:
        super().__init__()
        network, head = actor.module
        self.actor = actor
        self.in_keys = list(network.in_keys)
        self.out_keys = list(head.out_keys[:1])
        bounds = head.distribution_kwargs
        low, high = (torch.as_tensor(bounds.get(k, d)) for k, d in (("low", -1.0), ("high", 1.0)))
        self._affine = bool((low != -1).any() or (high != 1).any())
        self.register_buffer("_center", (high + low) / 2, persistent=False)
        self.register_buffer("_half_range", (high - low) / 2, persistent=False)
        self.__dict__["_network"] = network.module

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action into ``tensordict``."""
        loc, scale = self._network(*[tensordict.get(key) for key in self.in_keys])
        if exploration_type() in (ExplorationType.RANDOM, None):
            loc = torch.normal(torch.zeros_like(loc), torch.ones_like(loc)) * scale + loc
        return tensordict.set(self.out_keys[0], self._squash(loc))

    def _squash(self, value: Tensor) -> Tensor:
        limit = 1.0 - torch.finfo(value.dtype).eps
        squashed = value.tanh().clamp(-limit, limit)
        return self._half_range * squashed + self._center if self._affine else squashed


def as_acting_policy(actor: TensorDictModuleBase) -> TensorDictModuleBase:
    """The lean form of ``actor`` if it has one, else ``actor`` itself.

    Args:
        actor: any TensorDict policy.

    Returns:
        :class:`ActingPolicy` for a plain squashed Gaussian actor; parameters are shared, so that
        training ``actor`` trains what is returned.
    """
    parts = list(getattr(actor, "module", [])) if isinstance(actor, TensorDictSequential) else []
    if len(parts) != 2:
        return actor
    network, head = parts
    plain = (
        type(network) is TensorDictModule
        and list(network.out_keys) == ["loc", "scale"]
        and isinstance(head, ProbabilisticTensorDictModule)
        and head.distribution_class is TanhNormal
        and set(head.distribution_kwargs) <= {"low", "high"}
        and not head.return_log_prob
    )
    return ActingPolicy(actor) if plain else actor
