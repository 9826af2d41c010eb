"""Constrained policy optimisation: trust-region steps that keep the cost below a limit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.modules import ProbabilisticActor

from haim_torchrl.objectives.on_policy.functional import (
    episode_mean,
    gaussian_kl,
    standardised,
)
from haim_torchrl.objectives.on_policy.learner import JointLoss, OnPolicyLearner, ValueFactory
from haim_torchrl.objectives.on_policy.trust_region import (
    assign,
    backtrack,
    conjugate_gradient,
    constrained_step,
    flat,
)
from haim_torchrl.objectives.on_policy.value import StateValueLoss
from haim_torchrl.objectives.optimization import UpdateStep


class CPOLearner(OnPolicyLearner):
    r"""Constrained policy optimisation (Achiam, Held, Tamar and Abbeel, ICML 2017).

    One policy step for each batch: the best one whose predicted cost is within the limit and whose
    divergence is within the trust region
    (:func:`~haim_torchrl.objectives.on_policy.trust_region.constrained_step`), shortened until
    divergence, reward and cost are as promised on the batch itself. Both values are then regressed
    on minibatches. There is neither a clip nor a coefficient of the divergence.

    The limit is per episode, the advantages are per step: a change of the mean cost advantage by
    1/L changes an episode of L steps by 1, so the excess is divided by the mean length.

    Args:
        actor: the policy.
        make_value: makes the value networks, that of the reward and that of the cost.
        limit: bound of an episode's mean cost, undiscounted, at least 0.
        max_kl: radius δ of the trust region, mean divergence [nats], positive.
        damping: added to the diagonal of the Fisher matrix, positive.
        solver_iterations: products with it, for each of the two gradients, at least 1.
        tries: step lengths to try, each 0.8 of the one before, at least 1.
        value_lr: learning rate of Adam for the values.
        reward_key: entry under ``next`` of the reward.
        cost_key: entry under ``next`` of the cost.
        **options: of :class:`~haim_torchrl.objectives.on_policy.learner.OnPolicyLearner`; epochs
            and minibatches are those of the values.

    Raises:
        ValueError: if a number is out of range.
    """

    def __init__(
        self,
        actor: ProbabilisticActor,
        make_value: ValueFactory,
        *,
        limit: float = 0.1,
        max_kl: float = 0.01,
        damping: float = 0.1,
        solver_iterations: int = 10,
        tries: int = 10,
        value_lr: float = 1e-3,
        reward_key: NestedKey = "reward",
        cost_key: NestedKey = "cost",
        **options: Any,
    ) -> None:
        super().__init__(actor, **options)
        if not 0.0 <= limit < math.inf:
            raise ValueError(f"limit must be a number of at least 0, got {limit}.")
        for name, number in (("max_kl", max_kl), ("damping", damping)):
            if not number > 0.0:
                raise ValueError(f"{name} must be positive, got {number}.")
        for name, count in (("solver_iterations", solver_iterations), ("tries", tries)):
            if count < 1:
                raise ValueError(f"{name} must be at least 1, got {count}.")
        self.limit, self.max_kl, self.damping = limit, max_kl, damping
        self.solver_iterations, self.tries = solver_iterations, tries
        self.reward_key, self.cost_key = reward_key, cost_key
        losses: dict[str, nn.Module] = {}
        self._estimators = []
        for prefix, key in (("", reward_key), ("cost_", cost_key)):
            out_key = f"{prefix}value" if prefix else "state_value"
            value = make_value(out_key=out_key)
            self._estimators.append(self.make_advantage(value, key, prefix))
            term = StateValueLoss(value, name=f"{prefix}value")
            term.set_keys(value=out_key, value_target=f"{prefix}value_target")
            losses[term.loss_name] = term
        loss = JointLoss(losses)
        optimizer = Adam(loss.parameters(), lr=value_lr, fused=True)
        self.update_values = UpdateStep(loss, optimizer)
        self._parts |= {"loss": loss, "optimizer": optimizer}

    @property
    def signals(self) -> Sequence[NestedKey]:
        """Reward and cost."""
        return [("next", self.reward_key), ("next", self.cost_key)]

    def learn(self, batch: TensorDictBase) -> Iterator[TensorDictBase]:
        """See :meth:`OnPolicyLearner.learn`; a policy step, then the values' updates."""
        data = self.prepare(batch)
        for estimator in self._estimators:
            estimator(data)
        data["advantage"] = standardised(data["advantage"])
        data["cost_advantage"] = data["cost_advantage"] - data["cost_advantage"].mean()
        figures = self.step(data)
        for minibatch in self.minibatches(data):
            yield self.update_values(minibatch).update(figures)

    def step(self, data: TensorDictBase) -> TensorDictBase:
        """Moves the policy once.

        Args:
            data: a batch as :meth:`prepare` made it, with ``advantage`` and ``cost_advantage``.

        Returns:
            Figures of the step: ``divergence`` [nats], ``episode_cost``, ``price`` of the
            constraint, ``recovery`` and ``step_share`` (of the full step) in [0, 1].
        """
        after = data["next"]
        episode = episode_mean(after[self.cost_key], after["done"])
        excess = (episode.cost - self.limit) / episode.length
        parameters = list(self.actor.parameters())
        gain, cost, divergence = self._measure(data)
        gradient, cost_gradient = (
            flat(torch.autograd.grad(value, parameters, retain_graph=True))
            for value in (gain, cost)
        )
        slopes = flat(torch.autograd.grad(divergence, parameters, create_graph=True))

        def fisher(vector: Tensor) -> Tensor:
            image = torch.autograd.grad(slopes @ vector, parameters, retain_graph=True)
            return flat(image) + self.damping * vector

        solve = partial(conjugate_gradient, fisher, iterations=self.solver_iterations)
        full = constrained_step(gradient, cost_gradient, excess, solve, self.max_kl)
        start = flat(parameters).detach()
        reached = {"divergence": torch.zeros_like(excess)}

        @torch.no_grad()
        def accept(vector: Tensor) -> bool:
            assign(parameters, start + vector)
            new_gain, new_cost, reached["divergence"] = self._measure(data)
            # Comparisons with NaN are false: a step into nowhere is not taken.
            return bool(
                (reached["divergence"] <= self.max_kl)
                & ((new_gain >= gain) | (excess > 0.0))
                & (new_cost - cost <= (-excess).clamp_min(0.0))
            )

        vector, share = backtrack(full.vector, accept, tries=self.tries)
        assign(parameters, start + vector)
        return TensorDict(
            {
                "divergence": reached["divergence"] if share else torch.zeros_like(excess),
                "episode_cost": episode.cost,
                "price": full.price,
                "recovery": torch.full_like(excess, full.recovery),
                "step_share": torch.full_like(excess, share),
            }
        )

    def _measure(self, data: TensorDictBase) -> tuple[Tensor, Tensor, Tensor]:
        """Surrogates of reward and cost, and the divergence from the policy that drove."""
        seen = data.select(*self.actor.in_keys)
        new = self.actor.get_dist_params(seen)
        log_prob = self.actor.build_dist_from_params(new).log_prob(data["action"])
        ratio = (log_prob - data["action_log_prob"]).exp().unsqueeze(-1)
        divergence = gaussian_kl(data["loc"], data["scale"], new["loc"], new["scale"])
        return (
            (ratio * data["advantage"]).mean(),
            (ratio * data["cost_advantage"]).mean(),
            divergence.mean(),
        )
