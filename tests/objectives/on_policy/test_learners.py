"""PPO, PPO-Lagrangian and CPO on a problem of one step whose optimum is known.

The reward is the action and the cost its square: with a limit of 1/4 the best action is 1/2.
"""

from __future__ import annotations

import math
from copy import deepcopy
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import make_actor
from haim_torchrl.objectives import LagrangeMultiplier, NonFiniteLossError
from haim_torchrl.objectives.on_policy import (
    CPOLearner,
    OnPolicyLearner,
    PPOLagrangianLearner,
    PPOLearner,
)

from .bandit import drive, make_small_value, train

FAST: dict[str, Any] = {"epochs": 4, "minibatch_size": 128, "lr": 3e-3}


def lagrangian(
    actor: ProbabilisticActor, gains: tuple[float, float, float] | None = None, **options: Any
) -> PPOLagrangianLearner:
    multiplier = LagrangeMultiplier(0.25, lr=0.3, gains=gains)
    return PPOLagrangianLearner(
        actor, make_small_value, multiplier=multiplier, **{**FAST, **options}
    )


def constrained(actor: ProbabilisticActor, **options: Any) -> CPOLearner:
    settings = {"limit": 0.25, "epochs": 2, "minibatch_size": 128, **options}
    return CPOLearner(actor, make_small_value, **settings)


def shaped(actor: ProbabilisticActor, **options: Any) -> PPOLearner:
    return PPOLearner(actor, make_small_value, **{"cost_weight": 1.0, **FAST, **options})


def test_shaping_finds_the_compromise(actor: ProbabilisticActor) -> None:
    # a - w a^2 is best at 1 / (2 w).
    end = train(shaped(actor, cost_weight=2.0), rounds=20)
    assert float(end["reward"].mean()) == pytest.approx(0.25, abs=0.06)


def test_the_price_holds_the_limit_at_the_optimum(actor: ProbabilisticActor) -> None:
    learner = lagrangian(actor, gains=(2.0, 0.2, 0.0))
    end = train(learner, rounds=45)
    assert float(end["cost"].mean()) < 0.25 + 0.05
    assert float(end["reward"].mean()) == pytest.approx(0.5, abs=0.08)
    # Where a - price * a^2 is best at 1/2.
    assert float(learner.multiplier.value) == pytest.approx(1.0, abs=0.2)


def test_the_trust_region_holds_the_limit_at_the_optimum(actor: ProbabilisticActor) -> None:
    end = train(constrained(actor), rounds=30)
    assert float(end["cost"].mean()) < 0.25 + 0.05
    assert float(end["reward"].mean()) == pytest.approx(0.5, abs=0.08)


def test_recovery_from_a_start_far_beyond_the_limit(actor: ProbabilisticActor) -> None:
    with torch.no_grad():
        actor.module[0].module.layers[-1].bias[0] += 1.5  # most actions are near 1
    learner = constrained(actor)
    first = drive(actor, 256)
    figures = list(learner.learn(first))[-1]
    assert float(figures["episode_cost"]) > 0.7
    assert float(figures["recovery"]) == 1.0 and float(figures["step_share"]) > 0.0
    assert drive(actor, 4000)["next", "cost"].mean() < first["next", "cost"].mean()
    end = train(learner, rounds=30)
    assert float(end["cost"].mean()) < 0.25 + 0.05


def test_no_step_leaves_the_trust_region(actor: ProbabilisticActor) -> None:
    learner = constrained(actor, max_kl=0.003)
    shares = []
    for _ in range(8):
        figures = list(learner.learn(drive(actor, 128)))[-1]
        assert 0.0 <= float(figures["divergence"]) <= 0.003
        shares.append(float(figures["step_share"]))
    assert max(shares) > 0.0


def test_a_step_into_nowhere_is_not_taken(actor: ProbabilisticActor) -> None:
    learner = constrained(actor)
    before = [parameter.clone() for parameter in actor.parameters()]
    data = learner.prepare(drive(actor, 64))
    data["advantage"], data["cost_advantage"] = data["action"] * math.nan, data["action"]
    figures = learner.step(data)
    assert float(figures["step_share"]) == 0.0 and float(figures["divergence"]) == 0.0
    assert all(torch.equal(a, b) for a, b in zip(before, actor.parameters()))


def test_the_combined_advantage_by_hand(actor: ProbabilisticActor) -> None:
    learner = lagrangian(actor)
    data = learner.prepare(drive(actor, 64))
    for estimator in (learner.advantage, learner.cost_advantage):
        with torch.no_grad():  # values of zero: advantages are reward and cost themselves
            for parameter in estimator.value_network.parameters():
                parameter.zero_()
    data["next", "learned_reward"] = learner.reward(data)
    learner.judge(data)
    reward, cost = data["next", "reward"], data["next", "cost"]
    price = max(0.0, 0.3 * (float(cost.mean()) - 0.25))
    torch.testing.assert_close(data["advantage"], (reward - price * cost) / (1.0 + price))
    torch.testing.assert_close(data["cost_value_target"], cost)
    assert float(learner.figures()["episode_cost"]) == pytest.approx(float(cost.mean()))


def test_an_expensive_batch_raises_the_price(actor: ProbabilisticActor) -> None:
    learner = lagrangian(actor)
    batch = drive(actor, 64, cost=torch.ones_like)
    prices = [float(losses["multiplier"]) for losses in learner.learn(batch)]
    assert prices == pytest.approx([0.3 * 0.75] * len(prices))


def test_actions_at_the_bounds_have_a_finite_density(actor: ProbabilisticActor) -> None:
    learner = shaped(actor, max_grad_norm=0.5)
    batch = drive(actor, 64)
    batch["action"][:32], batch["action"][32:] = 1.0, -1.0
    for losses in learner.learn(batch):
        assert all(torch.isfinite(value).all() for value in losses.values())
    assert all(torch.isfinite(parameter).all() for parameter in actor.parameters())


def test_the_batch_is_left_as_it_was(actor: ProbabilisticActor) -> None:
    batch = drive(actor, 64)
    before = batch.clone()
    list(shaped(actor).learn(batch))
    assert set(batch.keys(True, True)) == set(before.keys(True, True))
    assert (batch == before).all()


def test_several_environments_are_estimated_apart(actor: ProbabilisticActor) -> None:
    learner = shaped(actor, gamma=1.0, lmbda=1.0)
    with torch.no_grad():
        for parameter in learner.advantage.value_network.parameters():
            parameter.zero_()
    rows = drive(actor, 6).reshape(2, 3)  # two environments, of which one ends after 3 steps
    rows["next", "done"] = torch.tensor([[0, 0, 1], [0, 1, 1]]).bool().unsqueeze(-1)
    rows["next", "terminated"] = rows["next", "done"].clone()
    data = learner.prepare(rows)
    data["next", "learned_reward"] = torch.tensor([[1.0, 2, 3], [4, 5, 6]]).unsqueeze(-1)
    learner.judge(data)
    assert data["advantage"].squeeze(-1).tolist() == [[6.0, 5.0, 3.0], [9.0, 5.0, 6.0]]


@pytest.mark.parametrize("make", [shaped, lagrangian, constrained])
def test_a_saved_learner_goes_on_as_if_nothing_had_been(make: Any) -> None:
    def start() -> tuple[ProbabilisticActor, OnPolicyLearner]:
        torch.manual_seed(3)
        actor = make_actor(1, 1, (8,))
        return actor, make(actor)

    (actor, learner), (again, resumed) = start(), start()
    batch = drive(actor, 128)
    list(learner.learn(batch))
    resumed.load_state_dict(deepcopy(learner.state_dict()))
    again.load_state_dict(actor.state_dict())
    for one in (learner, resumed):
        torch.manual_seed(5)
        list(one.learn(drive(one.actor, 128)))
    for a, b in zip(actor.parameters(), again.parameters()):
        assert torch.equal(a, b)


@pytest.mark.parametrize("make", [shaped, lagrangian, constrained])
@pytest.mark.parametrize("key", [("next", "cost"), ("next", "reward"), "observation"])
def test_a_missing_entry_is_named(make: Any, key: Any, actor: ProbabilisticActor) -> None:
    with pytest.raises(KeyError, match=key if isinstance(key, str) else key[-1]):
        list(make(actor).learn(drive(actor, 8).exclude(key)))


def test_nan_stops_before_it_reaches_the_policy(actor: ProbabilisticActor) -> None:
    before = [parameter.clone() for parameter in actor.parameters()]
    batch = drive(actor, 64, reward=lambda action: action * math.nan)
    with pytest.raises(NonFiniteLossError):
        list(shaped(actor).learn(batch))
    assert all(torch.equal(a, b) for a, b in zip(before, actor.parameters()))


def with_other_names(batch: TensorDictBase) -> TensorDictBase:
    after = batch["next"].rename_key_("reward", "profit").rename_key_("cost", "harm")
    return batch.set("next", after)


@pytest.mark.parametrize("make", [shaped, lagrangian, constrained])
def test_reward_and_cost_may_have_other_names(make: Any, actor: ProbabilisticActor) -> None:
    learner = make(actor, reward_key="profit", cost_key="harm")
    assert list(learner.learn(with_other_names(drive(actor, 64))))


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (shaped, {"cost_weight": -1.0}, "cost_weight must be at least 0"),
        (shaped, {"clip_epsilon": 1.0}, "clip_epsilon must lie in"),
        (shaped, {"gamma": 1.1}, "gamma must lie in"),
        (shaped, {"epochs": 0}, "epochs must be at least 1"),
        (shaped, {"kl_coefficient": -0.1}, "kl_coefficient must be at least 0"),
        (constrained, {"limit": -0.1}, "limit must be a number of at least 0"),
        (constrained, {"max_kl": 0.0}, "max_kl must be positive"),
        (constrained, {"tries": 0}, "tries must be at least 1"),
    ],
)
def test_numbers_out_of_range_are_named(
    make: Any, options: dict[str, Any], words: str, actor: ProbabilisticActor
) -> None:
    with pytest.raises(ValueError, match=words):
        make(actor, **options)
