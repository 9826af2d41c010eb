"""Preference of the mentor's action over what it replaced: linear, bounded, conservative."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.term import CriticTerm, PolicyTerm


class PreferenceTerm(CriticTerm):
    """Base of the losses that order two actions on the proxy critic.

    The mentor's action is read at ``action``, the executed one, by default: where the mentor
    intervened both are the same, elsewhere the term is zero, and so its values are those that the
    temporal-difference term needs anyway. ``set_keys(action_mentor="action_mentor")`` reads it
    from an entry of its own.

    Args:
        critic_network: the proxy critic, the same module as in
            :class:`~haim_torchrl.objectives.ProxyQLoss`; the parameters are shared.
        weight: weight of the term.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @dataclass
    class _AcceptedKeys(CriticTerm._AcceptedKeys):
        action_agent: NestedKey = "action_agent"
        action_mentor: NestedKey = "action"
        intervention: NestedKey = "intervention"

    default_keys = _AcceptedKeys
    _schedulable_buffers = frozenset({"weight"})

    weight: Tensor

    def __init__(
        self, critic_network: TensorDictModule, *, weight: float, reduction: str | None = None
    ) -> None:
        super().__init__(critic_network, reduction=reduction)
        self.register_coeff_buffer("weight", float(weight))

    @property
    def loss_name(self) -> str:
        """Name of the entry that holds the loss."""
        return "loss_preference"

    @property
    def diagnostics(self) -> list[str]:
        """Share of intervened transitions, and how far the mentor's action is preferred there."""
        return ["preference_share", "preference_margin"]

    @abc.abstractmethod
    def preference(
        self, values_agent: Tensor, values_mentor: Tensor, intervention: Tensor
    ) -> Tensor:
        """The term of each transition without its weight, ``[..., 1]``."""

    def rejected_values(self, batch: ForwardPass) -> list[Tensor]:
        """Values of each action that the mentor's one is preferred to, ``[..., E]`` each."""
        params = self.critic_network_params
        return [batch.stored_values(self.critic, params, self.tensor_keys.action_agent)]

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Computes the loss and the diagnostics.

        Args:
            batch: the data and what has been computed from it.

        Returns:
            Loss, share of intervened transitions, mean of Q(mentor) − Q(agent) over them.
        """
        params, keys = self.critic_network_params, self.tensor_keys
        rejected = self.rejected_values(batch)
        values_mentor = batch.stored_values(self.critic, params, keys.action_mentor)
        intervention = batch.read(keys.intervention)
        terms = [self.preference(values, values_mentor, intervention) for values in rejected]
        loss = self.weight * torch.stack(terms).mean(0)
        count = intervention.sum()
        values_rejected = torch.stack(rejected).mean(0)
        gap = (values_mentor - values_rejected).detach().mean(-1, keepdim=True)
        margin = gap.masked_fill(~intervention, 0.0).sum() / count.clamp_min(1)
        numbers = (count / intervention.numel(), margin)
        return {
            self.loss_name: self._average(loss, intervention, batch),
            **dict(zip(self.diagnostics, numbers)),
        }

    def reads(self) -> Sequence[NestedKey]:
        """Observations, both actions, and who drove."""
        keys = self.tensor_keys
        return [
            *self.critic.observation_keys,
            keys.action_agent,
            keys.action_mentor,
            keys.intervention,
        ]

    def _average(self, loss: Tensor, intervention: Tensor, batch: ForwardPass) -> Tensor:
        return self._reduce(loss, batch)


class LinearPreferenceLoss(PreferenceTerm):
    r"""The paper's preference term (eq 16), :math:`\lambda I [Q(s, a_{agent}) - Q(s, a_{mentor})]`.

    The mean is taken over the whole batch, as printed: a batch with few takeovers then weighs
    less. λ = 10 is the "CQL loss temperature" of the paper's table (which lists the same number
    a second time as α).

    Args:
        critic_network: the proxy critic.
        weight: λ.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    def __init__(
        self,
        critic_network: TensorDictModule,
        *,
        weight: float = 10.0,
        reduction: str | None = None,
    ) -> None:
        super().__init__(critic_network, weight=weight, reduction=reduction)

    def preference(
        self, values_agent: Tensor, values_mentor: Tensor, intervention: Tensor
    ) -> Tensor:
        """Eq 16 without its weight, ``[..., 1]``."""
        return functional.linear_preference(values_agent, values_mentor, intervention)


class BoundedPreferenceLoss(PreferenceTerm):
    r"""Preference that draws values to ±1 instead of pushing them apart without limit (PVP).

    The mean is taken over the intervened transitions alone (zero if there are none), because the
    term is a regression of labels that only these have; so its strength does not depend on the
    share of takeovers in the batch.

    Args:
        critic_network: the proxy critic.
        weight: weight of the term.
        bound: label of a preferred action; a rejected one has ``-bound``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    def __init__(
        self,
        critic_network: TensorDictModule,
        *,
        weight: float = 1.0,
        bound: float = 1.0,
        reduction: str | None = None,
    ) -> None:
        super().__init__(critic_network, weight=weight, reduction=reduction)
        if not bound > 0.0:
            raise ValueError(f"bound must be positive, got {bound}.")
        self.bound = float(bound)

    def preference(
        self, values_agent: Tensor, values_mentor: Tensor, intervention: Tensor
    ) -> Tensor:
        """PVP's term without its weight, ``[..., 1]``."""
        return functional.bounded_preference(
            values_agent, values_mentor, intervention, bound=self.bound
        )

    def _average(self, loss: Tensor, intervention: Tensor, batch: ForwardPass) -> Tensor:
        return self._reduce(loss, batch, mask=intervention)


class ConservativePreferenceLoss(BoundedPreferenceLoss, PolicyTerm):
    r"""Bounded preference over what the policy would do now, as in conservative Q-learning.

    The rejected action is half the stored proposal and half a fresh draw of the policy at the
    same state. Labels at two stored actions say nothing about the actions beyond them, and a
    policy that climbs the values overshoots the mentor's action; here whatever the policy prefers
    to the mentor's action is pushed down, until it prefers nothing to it. (The critic is then the
    discriminator of a least-squares adversarial imitation on the mentor's states.)

    Args:
        actor_network: the agent's policy; this term does not train it.
        critic_network: the proxy critic.
        weight: weight of the term.
        bound: label of a preferred action; a rejected one has ``-bound``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        critic_network: TensorDictModule,
        *,
        weight: float = 1.0,
        bound: float = 1.0,
        reduction: str | None = None,
    ) -> None:
        super().__init__(critic_network, weight=weight, bound=bound, reduction=reduction)
        self.set_policy(actor_network)

    def rejected_values(self, batch: ForwardPass) -> list[Tensor]:
        """Values of the stored proposal and of a fresh one, ``[..., E]`` each."""
        action, _ = self.fresh_action(batch)
        params = self.critic_network_params
        return [
            *super().rejected_values(batch),
            batch.values(self.critic, params, action.detach()),
        ]
