"""Soft actor-critic under a limit on an episode's cost (SAC-Lagrangian)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictParams, dispatch
from torch import Tensor
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import SACLoss, ValueEstimators

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.functional import Reduction
from haim_torchrl.objectives.lagrange import LagrangeMultiplier
from haim_torchrl.objectives.networks import CriticFunction, PolicyFunction, critic_function


class SACLagrangianLoss(SACLoss):
    r"""TorchRL's soft actor-critic, with a cost critic and a multiplier in the policy's objective.

    .. math:: \max_\pi \; \frac{\min_e Q_e(s, a) - \lambda \max_e Q^C_e(s, a)}{1 + \lambda}
              - \alpha \log\pi(a|s),\quad a \sim \pi(\cdot|s)

    After Ha et al., "Learning to walk in the real world with minimal human effort" (CoRL 2020).
    Critics of the reward, their targets and the temperature are :class:`SACLoss`'s own. The cost
    critic is regressed at the executed action, without an entropy bonus, which would count as
    cost.

    The limit is one on the mean *episode*: a sum of costs, each counting fully however late it
    comes. The cost critic discounts, since by it the policy judges single actions, and is never
    held to the limit: what a discounted limit means depends on how long episodes are. What moves λ
    is the cost of the episodes that were driven; hand it to ``loss.multiplier.update``.

    Args:
        actor_network: the agent's policy.
        qvalue_network: one critic of the reward, ``[..., 1]``; the twins are made of it.
        cost_network: critic of the cost, reads observations and an action, writes ``[..., E]``.
        multiplier: λ; part of the loss's state.
        actor_reduction: how the policy reduces the cost critics; ``"max"`` is the cautious way.
        target_reduction: how their target does; see
            :class:`~haim_torchrl.objectives.CostCriticLoss` for why this is the minimum.
        **options: of :class:`SACLoss`, for instance ``alpha_init`` or ``loss_function``.

    Raises:
        ValueError: if a reduction is unknown.

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

    _out_keys: list[NestedKey] | None
    cost_network: TensorDictModule
    cost_network_params: TensorDictParams
    target_cost_network_params: TensorDictParams

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
        self._critic: CriticFunction | None = None
        super().__init__(actor_network, qvalue_network, **options)
        for name, value in (("actor", actor_reduction), ("target", target_reduction)):
            if value not in ("min", "max", "mean"):
                raise ValueError(f"{name}_reduction must be 'min', 'max' or 'mean', got {value!r}.")
        self.convert_to_functional(cost_network, "cost_network", create_target_params=True)
        self.multiplier = multiplier
        self.actor_reduction: Reduction = actor_reduction
        self.target_reduction: Reduction = target_reduction
        self._policy = PolicyFunction(self.actor_network, self.actor_network_params)
        self.target_entropy  # noqa: B018  found here, since it cannot be while compiling

    @property
    def cost_critic(self) -> CriticFunction:
        """The cost critic as a function of parameters, data and action."""
        if self._critic is None:
            self._critic = critic_function(
                self.cost_network,
                self.cost_network_params,
                action_key=self.tensor_keys.action,
                value_key=self.tensor_keys.state_action_value,
            )
        return self._critic

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Computes all losses of a batch.

        Args:
            tensordict: transitions, batch size ``[N]``.

        Returns:
            What :class:`SACLoss` returns, the cost critic's loss and mean value, and λ.

        Raises:
            KeyError: if the batch holds no cost.
        """
        result = dict(super().forward(tensordict).items())
        result["loss_cost"], result["cost_mean"] = self.cost_loss(tensordict)
        result["multiplier"] = self.multiplier.value.clone()
        return TensorDict(result)

    def cost_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Temporal-difference loss of the cost critic.

        Args:
            tensordict: transitions, batch size ``[N]``.

        Returns:
            The loss, reduced, and the mean value without gradient.

        Raises:
            KeyError: if the batch holds no cost.
        """
        batch, key = ForwardPass(tensordict), ("next", self.tensor_keys.cost)
        if tensordict.get(key, None) is None:
            raise KeyError(
                f"SACLagrangianLoss needs the entry {key!r}, which the batch lacks. Record it, or "
                "name another one with set_keys(cost=...)."
            )
        terminated = batch.read(("next", self.tensor_keys.terminated))
        gamma, steps = self.value_estimator.gamma, tensordict.get("steps_to_next_obs", None)
        action, _ = batch.next_action(self._policy, self.actor_network_params)
        values = batch.stored_values(
            self.cost_critic, self.cost_network_params, self.tensor_keys.action
        )
        target = functional.cost_td_target(
            batch.read(key),
            batch.next_values(self.cost_critic, self.target_cost_network_params, action),
            terminated,
            gamma=gamma if steps is None else gamma ** steps.view_as(terminated),
            reduction=self.target_reduction,
        )
        loss = functional.td_loss(values, target).squeeze(-1)
        return self._reduced(loss, tensordict), values.detach().mean()

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """The policy's loss, which :class:`SACLoss` calls for.

        Args:
            tensordict: transitions, batch size ``[N]``.

        Returns:
            The loss, reduced, and ``log_prob`` ``[N]`` of the fresh actions, for the temperature.
        """
        batch = ForwardPass(tensordict)
        action, log_prob = batch.fresh_action(self._policy, self.actor_network_params)
        seen = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        seen.set(self.tensor_keys.action, action)
        values = self._vmap_qnetworkN0(seen, self._cached_detached_qvalue_params)
        value = values.get(self.tensor_keys.state_action_value).amin(0)
        costs = batch.values(self.cost_critic, self.cost_network_params, action, detach=True)
        cost = functional.reduce_ensemble(costs, self.actor_reduction)
        penalised = functional.penalised_value(value, cost, self.multiplier.value)
        objective = functional.actor_objective(log_prob, [(1.0, penalised)], self._alpha)
        loss = self._reduced(-objective.squeeze(-1), tensordict)
        return loss, {"log_prob": log_prob.detach().squeeze(-1)}

    @property
    def out_keys(self) -> list[NestedKey]:
        """Entries of the result: :class:`SACLoss`'s, the cost critic's, and λ."""
        if self._out_keys is None:
            sac = ["loss_actor", "loss_qvalue", "loss_alpha", "alpha", "entropy"]
            self._out_keys = [*sac, "loss_cost", "cost_mean", "multiplier"]
        return self._out_keys

    @out_keys.setter
    def out_keys(self, keys: list[NestedKey]) -> None:
        self._out_keys = keys

    def _reduced(self, loss: Tensor, tensordict: TensorDictBase) -> Tensor:
        weights = self._maybe_get_priority_weight(tensordict)
        return self._reduce_loss(loss, tensordict=tensordict, weights=weights)

    def _set_in_keys(self) -> None:
        super()._set_in_keys()
        self._in_keys.append(("next", self.tensor_keys.cost))

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        super()._forward_value_estimator_keys(**kwargs)
        self._critic = None
