"""What a saved state brings back, and what it does not."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import nn
from torchrl.objectives import SACLoss

from haim_torchrl.modules import make_actor, make_critic
from haim_torchrl.modules.temperature import Temperature
from haim_torchrl.objectives import LagrangeMultiplier
from haim_torchrl.objectives.on_policy import PPOLagrangianLearner
from haim_torchrl.objectives.resuming import load_learned

from .on_policy.bandit import drive, make_small_value


def test_an_optimizer_keeps_its_settings_and_takes_the_moments() -> None:
    def adam(**options: Any) -> torch.optim.Adam:
        network = nn.Linear(2, 1)
        groups = [{"params": [network.weight], "name": "a"}, {"params": [network.bias], "lr": 1.0}]
        return torch.optim.Adam(groups, **options)

    saved, resumed = adam(lr=1e-3, eps=1e-8), adam(lr=1e-4, eps=1e-5)
    for group in saved.param_groups:
        group["params"][0].grad = torch.ones_like(group["params"][0])
    saved.step()
    load_learned(resumed, saved.state_dict())
    assert [group["lr"] for group in resumed.param_groups] == [1e-4, 1.0]
    assert {group["eps"] for group in resumed.param_groups} == {1e-5}
    moments = resumed.state[resumed.param_groups[0]["params"][0]]
    assert float(moments["step"]) == 1.0 and float(moments["exp_avg"].sum()) == pytest.approx(0.2)


def test_a_multiplier_goes_on_under_the_limit_of_now() -> None:
    saved, resumed = LagrangeMultiplier(1.0, lr=0.5), LagrangeMultiplier(3.0, lr=0.5)
    saved.update(5.0)
    load_learned(resumed, saved.state_dict())
    assert resumed.value.item() == 2.0
    assert resumed.update(5.0).item() == 3.0  # 2 + 0.5 (5 - 3)


def test_a_loss_of_torchrls_keeps_discount_and_target() -> None:
    def soft(gamma: float, entropy: float) -> SACLoss:
        actor, critic = make_actor(1, 1, (4,)), make_critic(1, 1, (4,), ensemble_size=1)
        loss = SACLoss(actor, critic, target_entropy=entropy)
        loss.make_value_estimator(gamma=gamma)
        return loss

    saved, resumed = soft(0.9, -1.0), soft(0.5, -2.0)
    with torch.no_grad():
        saved.log_alpha.fill_(0.25)
    load_learned(resumed, saved.state_dict())
    state = resumed.state_dict()
    assert float(state["_value_estimator.gamma"]) == 0.5
    assert float(resumed.target_entropy) == -2.0
    learned = saved.state_dict()
    assert float(state["log_alpha"]) == 0.25
    networks = [key for key in state if "_network_params" in key]
    assert len(networks) > 4 and any(key.startswith("target") for key in networks)
    assert all(torch.equal(state[key], learned[key]) for key in networks)


@pytest.mark.parametrize(("learnable", "expected"), [(True, 0.5), (False, 0.25)])
def test_a_temperature_comes_back_where_it_is_learned(learnable: bool, expected: float) -> None:
    resumed = Temperature(0.25, learnable=learnable)
    load_learned(resumed, Temperature(0.5, learnable=learnable).state_dict())
    assert resumed().item() == pytest.approx(expected)


def test_an_on_policy_learner_goes_on_with_its_own_settings() -> None:
    def make(clip: float, entropy: float, lr: float, limit: float) -> PPOLagrangianLearner:
        return PPOLagrangianLearner(
            make_actor(1, 1, (8,)),
            make_small_value,
            multiplier=LagrangeMultiplier(limit, lr=1.0),
            clip_epsilon=clip,
            entropy_coefficient=entropy,
            lr=lr,
            minibatch_size=64,
        )

    saved, resumed = make(0.2, 0.1, 1e-3, 0.0), make(0.3, 0.2, 1e-4, 9.0)
    list(saved.learn(drive(saved.actor, 64, cost=torch.ones_like)))
    resumed.load_state_dict(saved.state_dict())
    assert resumed.multiplier.value.item() == pytest.approx(1.0)
    assert resumed.multiplier.limit == 9.0
    assert {group["lr"] for group in resumed.update.optimizer.param_groups} == {1e-4}
    policy = resumed.update.loss.losses["policy"]
    assert float(policy.clip_epsilon) == pytest.approx(0.3)
    assert float(policy.entropy_coeff) == pytest.approx(0.2)
