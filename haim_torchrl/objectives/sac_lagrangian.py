"""Soft actor-critic under a limit on an episode's cost (SAC-Lagrangian)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, dispatch
from torch import Tensor
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import SACLoss, ValueEstimators

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.cost import CostCriticLoss
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.functional import Reduction
from haim_torchrl.objectives.lagrange import LagrangeMultiplier


class EnvironmentCostLoss(CostCriticLoss):
    """Expected discounted cost that the environment itself charges the executed action.

    Args:
        actor_network: the agent's policy.
        critic_network: reads observations and an action, writes ``[..., E]`` values.
        label: the loss is named ``loss_<label>``.
        actor_weight: see :class:`CostCriticLoss`.
        actor_reduction: see :class:`CostCriticLoss`.
        target_reduction: see :class:`CostCriticLoss`.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @property
    def action_key(self) -> NestedKey:
        """The executed action, which nobody else has proposed."""
        return self.tensor_keys.action


class SACLagrangianLoss(SACLoss):
    r"""TorchRL's soft actor-critic, with a cost critic and a multiplier in the policy's objective.

    .. math:: \max_\pi \; \frac{\min_e Q_e(s, a) - \lambda \max_e Q^C_e(s, a)}{1 + \lambda}
              - \alpha \log\pi(a|s),\quad a \sim \pi(\cdot|s)

    After Ha et al., "Learning to walk in the real world with minimal human effort" (CoRL 2020).
    Critics of the reward, their targets and the temperature are :class:`SACLoss`'s own; the cost
    critic is regressed like all cost critics here, without an entropy bonus.

    The limit is one on the mean *episode*: events, each counting fully however late it comes. The
    cost critic discounts, since it is what each action of the policy is judged by, and is never
    held to the limit: a discounted limit would depend on how long episodes are. What moves λ is
    the cost of the episodes that were driven; hand it to ``loss.multiplier.update`` after each
    batch.

    Args:
        actor_network: the agent's policy.
        qvalue_network: one critic of the reward, ``[..., 1]``; the twins are made of it.
        cost_network: critic of the cost, reads observations and an action, writes ``[..., E]``.
        multiplier: λ.
        actor_reduction: how the policy reduces the cost critics; ``"max"`` is cautious.
        target_reduction: how the cost critics' target reduces them; see :class:`CostCriticLoss`.
        **options: of :class:`SACLoss`, for instance ``alpha_init`` or ``loss_function``.

    Examples:
        >>> from haim_torchrl.modules import make_actor, make_critic
        >>> loss = SACLagrangianLoss(
        ...     make_actor(3, 2),
        ...     make_critic(3, 2, ensemble_size=1),
        ...     make_critic(3, 2),
        ...     LagrangeMultiplier(limit=0.1),
        ... )
        >>> [key for key in loss.out_keys if key.startswith("loss_")]
        ['loss_actor', 'loss_qvalue', 'loss_alpha', 'loss_cost']
    """

    @dataclass
    class _AcceptedKeys(SACLoss._AcceptedKeys):
        cost: NestedKey = "cost"

    default_keys = _AcceptedKeys
    SUPPORTED_VALUE_ESTIMATORS = (ValueEstimators.TD0,)

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        qvalue_network: TensorDictModule,
        cost_network: TensorDictModule,
        multiplier: LagrangeMultiplier,
        *,
        actor_reduction: Reduction = "max",
        target_reduction: Reduction = "min",
        **options: Any,
    ) -> None:
        super().__init__(actor_network, qvalue_network, **options)
        self.multiplier = multiplier
        self.cost_critic = EnvironmentCostLoss(
            actor_network,
            cost_network,
            actor_reduction=actor_reduction,
            target_reduction=target_reduction,
            reduction=self.reduction,
        )
        self._set_in_keys()
        self._out_keys = None

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Computes all losses of a batch.

        Args:
            tensordict: transitions, batch size ``[N]``.

        Returns:
            What :class:`SACLoss` returns, the cost critic's loss and diagnostics, and λ.

        Raises:
            KeyError: if the batch lacks an entry that the cost critic reads; it is named.
        """
        costs = self.cost_critic(tensordict)
        result = {**super().forward(tensordict), **costs, "multiplier": self.multiplier.value}
        return TensorDict(result)

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The policy's loss, which :class:`SACLoss` calls for.

        Args:
            tensordict: transitions, batch size ``[N]``.

        Returns:
            The loss, reduced, and ``log_prob`` ``[N]`` of the fresh actions, for the temperature.
        """
        batch, critic = ForwardPass(tensordict), self.cost_critic
        action, log_prob = critic.fresh_action(batch)
        seen = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        seen.set(self.tensor_keys.action, action)
        values = self._vmap_qnetworkN0(seen, self._cached_detached_qvalue_params)
        value = values.get(self.tensor_keys.state_action_value).amin(0)
        costs = batch.values(critic.critic, critic.critic_network_params, action, detach=True)
        cost = functional.reduce_ensemble(costs, critic.actor_reduction)
        penalised = functional.penalised_value(value, cost, self.multiplier.value)
        objective = functional.actor_objective(log_prob, [(1.0, penalised)], self._alpha)
        weights = self._maybe_get_priority_weight(tensordict)
        loss = self._reduce_loss(-objective.squeeze(-1), tensordict=tensordict, weights=weights)
        return loss, {"log_prob": log_prob.detach().squeeze(-1)}

    @property
    def out_keys(self) -> list[NestedKey]:
        """Entries of the result: :class:`SACLoss`'s, the cost critic's, and λ."""
        if self._out_keys is None:
            sac = ["loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy"]
            self._out_keys = [*sac, *self.cost_critic.out_keys, "multiplier"]
        return self._out_keys

    @out_keys.setter
    def out_keys(self, keys: Sequence[NestedKey]) -> None:
        self._out_keys = list(keys)

    def set_keys(self, **kwargs: NestedKey | None) -> None:
        """Renames entries, here and in the cost critic.

        Args:
            **kwargs: role of an entry and its new name; ``None`` is the default name.
        """
        super().set_keys(**kwargs)
        shared = {field.name for field in fields(EnvironmentCostLoss._AcceptedKeys)} - {"priority"}
        if "cost_critic" in self._modules:
            self.cost_critic.set_keys(**{k: v for k, v in kwargs.items() if k in shared})
            self._set_in_keys()

    def make_value_estimator(
        self, value_type: ValueEstimators | None = None, **hyperparams: Any
    ) -> SACLagrangianLoss:
        """Sets the discount factor of all critics.

        Args:
            value_type: only ``ValueEstimators.TD0``.
            **hyperparams: ``gamma``, in [0, 1].

        Returns:
            This loss.
        """
        if "cost_critic" in self._modules:
            self.cost_critic.make_value_estimator(value_type, **hyperparams)
        super().make_value_estimator(value_type or ValueEstimators.TD0, **hyperparams)
        return self

    def reset_parameters_recursive(self) -> None:
        """Draws all parameters anew."""
        super().reset_parameters_recursive()
        self.cost_critic.reset_parameters_recursive()

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        if "cost_critic" in self._modules:
            self._in_keys = list(dict.fromkeys([*self._in_keys, *self.cost_critic.in_keys]))
