"""What the on-policy learners have in common: a batch, who drove it, and minibatches of it."""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives.value import GAE

from haim_torchrl.objectives.resuming import load_learned

#: How far from its bounds an action's density is read. There the density of a squashed Gaussian is
#: a matter of the last bit: in single precision numbers next to 1 are 6e-8 apart.
ACTION_MARGIN = 1e-6

#: Entry under ``next`` that holds what a learner takes for the reward.
LEARNED_REWARD = "learned_reward"

ValueFactory = Callable[..., TensorDictModule]
"""Makes a state-value network; takes ``out_key``."""


class OnPolicyLearner(abc.ABC):
    """Learns from a batch that its own policy has just driven, and then forgets it.

    Args:
        actor: the policy, a squashed Gaussian over bounded actions.
        gamma: discount per step, in [0, 1].
        lmbda: λ of generalised advantage estimation, in [0, 1].
        epochs: passes over a batch, at least 1.
        minibatch_size: transitions in one update, at least 1.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self,
        actor: ProbabilisticActor,
        *,
        gamma: float = 0.99,
        lmbda: float = 0.95,
        epochs: int = 10,
        minibatch_size: int = 250,
    ) -> None:
        for name, share in (("gamma", gamma), ("lmbda", lmbda)):
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"{name} must lie in [0, 1], got {share}.")
        for name, count in (("epochs", epochs), ("minibatch_size", minibatch_size)):
            if count < 1:
                raise ValueError(f"{name} must be at least 1, got {count}.")
        self.actor = actor
        self.gamma, self.lmbda = gamma, lmbda
        self.epochs, self.minibatch_size = epochs, minibatch_size
        self._parts: dict[str, Any] = {}

    @abc.abstractmethod
    def learn(self, batch: TensorDictBase) -> Iterator[TensorDictBase]:
        """Learns from a batch, update by update.

        Args:
            batch: consecutive steps ``[T]``, or ``[B, T]`` of several environments, driven by the
                actor as it is.

        Yields:
            Losses and diagnostics of each update, without gradient.

        Raises:
            NonFiniteLossError: if a loss is NaN or infinite; its update was not done.
            KeyError: if the batch lacks an entry of :attr:`in_keys`.
        """

    @property
    @abc.abstractmethod
    def signals(self) -> Sequence[NestedKey]:
        """Entries of the batch that say how good or bad a step was."""

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries of the batch that are read, and no others."""
        seen = [*self.actor.in_keys]
        following = [("next", key) for key in (*seen, "done", "terminated")]
        return [*seen, "action", *following, *self.signals]

    def prepare(self, batch: TensorDictBase) -> TensorDictBase:
        """What is read of a batch, with the density that the actor had for each action.

        Args:
            batch: see :meth:`learn`.

        Returns:
            A tensordict of its own, also with ``loc``, ``scale`` and ``action_log_prob``.
        """
        for key in self.in_keys:
            if batch.get(key, default=None) is None:
                raise KeyError(
                    f"{type(self).__name__} needs the entry {key!r}, which the batch lacks; it "
                    f"has {sorted(map(str, batch.keys(True, True)))}."
                )
        device = next(self.actor.parameters()).device
        data = batch.select(*self.in_keys).to(device)
        space = self.actor.spec["action"].space
        data["action"] = inside(data["action"], space.low.to(device), space.high.to(device))
        with torch.no_grad():
            self.actor.get_dist_params(data)
            data["action_log_prob"] = self.actor.get_dist(data).log_prob(data["action"])
        return data

    def make_advantage(
        self, value_network: TensorDictModule, reward: NestedKey, prefix: str = ""
    ) -> GAE:
        """Makes TorchRL's generalised advantage estimation for a reward, or for a cost.

        It bootstraps through a truncation, and through the end of the batch.

        Args:
            value_network: its values.
            reward: entry under ``next`` that is summed up.
            prefix: of the entries ``advantage`` and ``value_target`` that it writes.

        Returns:
            The estimator.
        """
        estimator = GAE(
            gamma=self.gamma,
            lmbda=self.lmbda,
            value_network=value_network,
            device=next(self.actor.parameters()).device,
        )
        estimator.set_keys(
            advantage=f"{prefix}advantage",
            value_target=f"{prefix}value_target",
            value=value_network.out_keys[0],
            reward=reward,
        )
        return estimator

    def minibatches(self, data: TensorDictBase) -> Iterator[TensorDictBase]:
        """Each transition once in each epoch, in random order."""
        flat = data.exclude("next").reshape(-1)
        for _ in range(self.epochs):
            for rows in torch.randperm(len(flat), device=flat.device).split(self.minibatch_size):
                yield flat[rows]

    def state_dict(self) -> dict[str, Any]:
        """Networks, optimisers and whatever else changes, except for the actor."""
        return {name: part.state_dict() for name, part in self._parts.items()}

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Goes on from a saved state, with the settings of now (:func:`load_learned`).

        Args:
            state_dict: result of :meth:`state_dict`.
        """
        for name, part in self._parts.items():
            load_learned(part, state_dict[name])


def inside(action: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """Actions a little within their bounds, where their density can be read.

    Args:
        action: ``[..., A]``.
        low: lower bounds, ``[A]``.
        high: upper bounds, ``[A]``.

    Returns:
        The actions, moved by at most :data:`ACTION_MARGIN` of half the range.
    """
    margin = ACTION_MARGIN * (high - low) / 2.0
    return torch.minimum(torch.maximum(action, low + margin), high - margin)


class JointLoss(nn.Module):
    """Several losses of one batch, trained together.

    Args:
        losses: by name. An entry that a loss calls just ``loss`` gets that name behind it.
    """

    def __init__(self, losses: Mapping[str, nn.Module]) -> None:
        super().__init__()
        self.losses = nn.ModuleDict(losses)

    def forward(self, batch: TensorDictBase) -> TensorDictBase:
        """All losses and diagnostics of a batch."""
        joint: dict[str, Tensor] = {}
        for name, loss in self.losses.items():
            for key, value in loss(batch).items():
                joint[f"loss_{name}" if key == "loss" else str(key)] = value
        return TensorDict(joint)
