"""Proximal policy optimisation that holds the cost of an episode below a limit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.modules import ProbabilisticActor

from haim_torchrl.objectives.functional import penalised_value
from haim_torchrl.objectives.lagrange import LagrangeMultiplier
from haim_torchrl.objectives.on_policy.functional import episode_mean
from haim_torchrl.objectives.on_policy.learner import ValueFactory
from haim_torchrl.objectives.on_policy.ppo import ProximalLearner
from haim_torchrl.objectives.on_policy.value import StateValueLoss


class PPOLagrangianLearner(ProximalLearner):
    """Proximal policy optimisation under a limit of the cost, with a Lagrange multiplier.

    The cost has values and advantages of its own. Its advantage is taken off that of the reward
    (:func:`~haim_torchrl.objectives.functional.penalised_value`), at a price that rises while
    episodes cost more than the limit, and is in units of reward per cost: both advantages are
    combined as they are, and what results is standardised. (Standardised before, the reward's would
    grow beside the cost's as the policy's spread becomes small.) Ray, Achiam and Amodei,
    "Benchmarking Safe Exploration in Deep Reinforcement Learning" (2019); Stooke, Achiam and Abbeel
    (ICML 2020).

    Args:
        actor: the policy.
        make_value: makes the value networks, that of the reward and that of the cost.
        multiplier: the price, and the limit of an episode's cost.
        reward_key: entry under ``next`` of the reward.
        cost_key: entry under ``next`` of the cost.
        **options: of :class:`~haim_torchrl.objectives.on_policy.ppo.ProximalLearner`.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self,
        actor: ProbabilisticActor,
        make_value: ValueFactory,
        *,
        multiplier: LagrangeMultiplier,
        reward_key: NestedKey = "reward",
        cost_key: NestedKey = "cost",
        **options: Any,
    ) -> None:
        self.reward_key, self.cost_key = reward_key, cost_key
        cost_value = make_value(out_key="cost_value")
        loss = StateValueLoss(cost_value, name="cost_value")
        loss.set_keys(value="cost_value", value_target="cost_value_target")
        super().__init__(actor, make_value, terms={"cost_value": loss}, **options)
        self.cost_advantage = self.make_advantage(cost_value, cost_key, prefix="cost_")
        self.multiplier = multiplier.to(next(actor.parameters()).device)
        self._parts["multiplier"] = self.multiplier

    @property
    def signals(self) -> Sequence[NestedKey]:
        """Reward and cost."""
        return [("next", self.reward_key), ("next", self.cost_key)]

    def reward(self, data: TensorDictBase) -> Tensor:
        """The environment's reward as it is."""
        return data["next", self.reward_key]

    def judge(self, data: TensorDictBase) -> None:
        """Moves the multiplier by the batch's episodes, then writes the combined advantage."""
        super().judge(data)
        self.cost_advantage(data)
        after = data["next"]
        self.multiplier.update(episode_mean(after[self.cost_key], after["done"]).cost)
        data["advantage"] = penalised_value(
            data["advantage"], data["cost_advantage"], self.multiplier.value
        )

    def figures(self) -> dict[str, Tensor]:
        """The price, and the mean cost of an episode that it was last set by."""
        return {
            "multiplier": self.multiplier.value.clone(),
            "episode_cost": self.multiplier.previous_cost.clone(),
        }
