"""Formulas, values and penalties of the on-policy baselines, by hand."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict
from torch.distributions import Normal, kl_divergence
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import make_discriminator, make_value
from haim_torchrl.objectives.on_policy import PolicyDivergenceLoss, StateValueLoss
from haim_torchrl.objectives.on_policy.functional import (
    episode_mean,
    gaussian_kl,
    imitation_reward,
    standardised,
)

numbers = st.floats(-3.0, 3.0)
spreads = st.floats(0.1, 3.0)


@given(numbers, spreads, numbers, spreads)
def test_divergence_is_that_of_torch(loc: float, scale: float, to: float, width: float) -> None:
    old, new = torch.tensor([[loc], [scale]]).double(), torch.tensor([[to], [width]]).double()
    expected = kl_divergence(Normal(*old), Normal(*new))
    torch.testing.assert_close(gaussian_kl(*old, *new), expected, atol=1e-9, rtol=1e-6)


def test_divergence_adds_up_over_the_action() -> None:
    loc, one = torch.zeros(4, 2), torch.ones(4, 2)
    torch.testing.assert_close(gaussian_kl(loc, one, loc + 1.0, one), torch.ones(4, 1))


def test_imitation_reward_is_minus_the_log_of_being_found_out() -> None:
    logits = torch.tensor([[-2.0], [0.0], [3.0]])
    torch.testing.assert_close(imitation_reward(logits), -torch.log(1.0 - logits.sigmoid()))
    assert torch.isfinite(imitation_reward(torch.tensor([1000.0])))


def test_episodes_are_counted_by_their_ends() -> None:
    done = torch.tensor([[False, True, False], [False, False, True]]).unsqueeze(-1)
    cost = torch.tensor([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]]).unsqueeze(-1)
    mean = episode_mean(cost, done)
    assert float(mean.cost) == 1.5 and float(mean.length) == 3.0


def test_a_batch_in_which_none_ended_is_one_episode() -> None:
    mean = episode_mean(torch.ones(5, 1), torch.zeros(5, 1, dtype=torch.bool))
    assert float(mean.cost) == 5.0 and float(mean.length) == 5.0


def test_standardised_by_hand_and_without_spread() -> None:
    torch.testing.assert_close(standardised(torch.tensor([1.0, 3.0])), torch.tensor([-1.0, 1.0]))
    assert standardised(torch.full((4,), 7.0)).tolist() == [0.0] * 4


def test_value_loss_by_hand() -> None:
    value = make_value(2, hidden=(4,), out_key="cost_value")
    with torch.no_grad():
        for parameter in value.parameters():
            parameter.zero_()
    loss = StateValueLoss(value, name="cost")
    loss.set_keys(value="cost_value", value_target="goal")
    batch = TensorDict(observation=torch.zeros(2, 2), goal=torch.tensor([[1.0], [3.0]]))
    result = loss(batch)
    assert result["loss_cost"].item() == pytest.approx((0.5 * 1.0 + 0.5 * 9.0) / 2.0)
    result["loss_cost"].backward()
    assert {id(p) for p in loss.trained_parameters()} == {id(p) for p in value.parameters()}
    assert loss.in_keys == ["observation", "goal"]
    with pytest.raises(KeyError, match="goal"):
        loss(batch.exclude("goal"))


def test_penalty_of_leaving_the_policy_by_hand(actor: ProbabilisticActor) -> None:
    loss = PolicyDivergenceLoss(actor, 2.0)
    batch = TensorDict(observation=torch.ones(3, 1), batch_size=[3])
    actor.get_dist_params(batch)
    batch = batch.detach()
    assert loss(batch)["loss_divergence"].item() == pytest.approx(0.0, abs=1e-6)
    batch["loc"] = batch["loc"] + batch["scale"]
    result = loss(batch)["loss_divergence"]
    assert result.item() == pytest.approx(2.0 * 0.5, rel=1e-5)
    result.backward()
    assert all(p.grad is not None for p in actor.parameters())


def test_a_discriminator_writes_odds_and_probability() -> None:
    pairs = TensorDict(observation=torch.randn(4, 3), action=torch.randn(4, 2), batch_size=[4])
    judged = make_discriminator(3, 2, (8,))(pairs)
    odds = (judged["d_logits"] / (1.0 - judged["d_logits"])).log()
    torch.testing.assert_close(judged["logits"], odds, atol=1e-5, rtol=1e-4)


def test_networks_refuse_several_entries() -> None:
    with pytest.raises(TypeError, match="read one vector"):
        make_value({"pixels": (3, 8, 8)})  # type: ignore[arg-type]
