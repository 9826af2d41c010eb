"""Proximal policy optimisation on the reward, with the cost as a negative one."""

from __future__ import annotations

import abc
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

from haim_torchrl.objectives.functional import shaped_reward
from haim_torchrl.objectives.on_policy.divergence import PolicyDivergenceLoss
from haim_torchrl.objectives.on_policy.functional import standardised
from haim_torchrl.objectives.on_policy.learner import (
    LEARNED_REWARD,
    JointLoss,
    OnPolicyLearner,
    ValueFactory,
)
from haim_torchrl.objectives.optimization import UpdateStep


class ProximalLearner(OnPolicyLearner):
    """Proximal policy optimisation (TorchRL's ``ClipPPOLoss`` and ``GAE``) on some reward.

    Schulman et al., "Proximal Policy Optimization Algorithms" (2017). A learner of one's own says
    by :meth:`reward` what a step is worth, and may change the advantages.

    Args:
        actor: the policy.
        make_value: makes the value network.
        lr: learning rate of Adam, for policy and values.
        clip_epsilon: how far the ratio of densities may be from 1, in (0, 1).
        entropy_coefficient: weight of the policy's entropy; 0 for none.
        kl_coefficient: weight of the divergence from the policy that drove; 0 for none.
        max_grad_norm: bound of the gradient's norm, for policy and values apart; None for none.
        terms: further losses by name, trained on the same minibatches, such as that of a second
            value; each has ``trained_parameters()``.
        **options: of :class:`OnPolicyLearner`.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self,
        actor: ProbabilisticActor,
        make_value: ValueFactory,
        *,
        lr: float = 3e-4,
        clip_epsilon: float = 0.2,
        entropy_coefficient: float = 0.0,
        kl_coefficient: float = 0.0,
        max_grad_norm: float | None = 0.5,
        terms: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        super().__init__(actor, **options)
        if not 0.0 < clip_epsilon < 1.0:
            raise ValueError(f"clip_epsilon must lie in (0, 1), got {clip_epsilon}.")
        for name, weight in (
            ("entropy_coefficient", entropy_coefficient),
            ("kl_coefficient", kl_coefficient),
        ):
            if weight < 0.0:
                raise ValueError(f"{name} must be at least 0, got {weight}.")
        value = make_value(out_key="state_value")
        self.advantage = self.make_advantage(value, LEARNED_REWARD)
        losses: dict[str, nn.Module] = {
            "policy": ClipPPOLoss(
                actor,
                value,
                clip_epsilon=clip_epsilon,
                entropy_bonus=entropy_coefficient > 0.0,
                entropy_coeff=entropy_coefficient,
            )
        }
        if kl_coefficient > 0.0:
            losses["divergence"] = PolicyDivergenceLoss(actor, kl_coefficient)
        groups = [{"params": list(part.parameters())} for part in (actor, value)]
        for name, term in (terms or {}).items():
            losses[name] = term
            groups.append({"params": term.trained_parameters()})
        loss, optimizer = JointLoss(losses), Adam(groups, lr=lr, fused=True)
        self.update = UpdateStep(loss, optimizer, max_grad_norm=max_grad_norm)
        self._parts |= {"loss": loss, "optimizer": optimizer}

    @abc.abstractmethod
    def reward(self, data: TensorDictBase) -> Tensor:
        """What each step is worth.

        Args:
            data: the batch, as :meth:`prepare` made it.

        Returns:
            Reward, shape of ``data`` and ``[1]``.
        """

    def judge(self, data: TensorDictBase) -> None:
        """Writes ``advantage`` and ``value_target``; the former is standardised afterwards."""
        self.advantage(data)

    def figures(self) -> dict[str, Tensor]:
        """Further diagnostics of the last batch."""
        return {}

    def learn(self, batch: TensorDictBase) -> Iterator[TensorDictBase]:
        """See :meth:`OnPolicyLearner.learn`."""
        data = self.prepare(batch)
        data["next", LEARNED_REWARD] = self.reward(data)
        self.judge(data)
        data["advantage"] = standardised(data["advantage"])
        for minibatch in self.minibatches(data):
            yield self.update(minibatch).update(self.figures())


class PPOLearner(ProximalLearner):
    """Proximal policy optimisation with reward shaping: reward less a multiple of the cost.

    Args:
        actor: the policy.
        make_value: makes the value network.
        cost_weight: reward that a cost of 1 takes away, at least 0.
        reward_key: entry under ``next`` of the reward.
        cost_key: entry under ``next`` of the cost.
        **options: of :class:`ProximalLearner`.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self,
        actor: ProbabilisticActor,
        make_value: ValueFactory,
        *,
        cost_weight: float = 5.0,
        reward_key: NestedKey = "reward",
        cost_key: NestedKey = "cost",
        **options: Any,
    ) -> None:
        if cost_weight < 0.0:
            raise ValueError(f"cost_weight must be at least 0, got {cost_weight}.")
        self.cost_weight, self.reward_key, self.cost_key = cost_weight, reward_key, cost_key
        super().__init__(actor, make_value, **options)

    @property
    def signals(self) -> Sequence[NestedKey]:
        """Reward and cost."""
        return [("next", self.reward_key), ("next", self.cost_key)]

    def reward(self, data: TensorDictBase) -> Tensor:
        """Reward less the weighted cost."""
        after = data["next"]
        return shaped_reward(after[self.reward_key], after[self.cost_key], self.cost_weight)
