"""Soft actor-critic under a limit on an episode's cost."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import SACLoss

from haim_torchrl.data import make_replay_buffer
from haim_torchrl.modules import make_actor, make_critic
from haim_torchrl.objectives import (
    LagrangeMultiplier,
    SACLagrangianLoss,
    TargetUpdater,
    UpdateStep,
    functional,
    make_optimizer,
)

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")


def column(*numbers: float) -> Tensor:
    return torch.tensor(numbers).unsqueeze(-1)


def constant_critic(value: float, size: int = 1) -> TensorDictModule:
    """A critic of one state that answers ``value + a``."""

    class Answer(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.bias = torch.nn.Parameter(torch.full((size,), value))

        def forward(self, observation: Tensor, action: Tensor) -> Tensor:
            return action + self.bias

    return TensorDictModule(
        Answer(), in_keys=["observation", "action"], out_keys=["state_action_value"]
    )


def transitions(cost: Tensor, terminated: Tensor) -> TensorDict:
    size = len(cost)
    return TensorDict(
        observation=torch.zeros(size, 1),
        action=torch.zeros(size, 1),
        next=TensorDict(
            observation=torch.zeros(size, 1),
            reward=torch.zeros(size, 1),
            cost=cost,
            done=terminated,
            terminated=terminated,
            batch_size=[size],
        ),
        batch_size=[size],
    )


def test_the_cost_target_by_hand() -> None:
    # Q_c = (2, 3) everywhere, and the targets the same.
    # y = 1 + 0.5 * min(2, 3) = 2 where it goes on, with the maximum 2.5; 1 where it ends.
    # Losses: (0 + 1) / 2, with the maximum (1/4 + 1/4) / 2; and (1 + 4) / 2.
    critic = make_critic(1, 1, hidden=(4,))
    with torch.no_grad():
        for parameter in critic.parameters():
            parameter.zero_()
        critic.module.biases[-1].copy_(torch.tensor([2.0, 3.0]).reshape(2, 1, 1))
    for reduction, expected in (("min", [0.5, 2.5]), ("max", [0.25, 2.5])):
        loss = SACLagrangianLoss(
            make_actor(1, 1, hidden=(4,)),
            constant_critic(0.0),
            critic,
            LagrangeMultiplier(1.0),
            target_reduction=reduction,  # type: ignore[arg-type]
            reduction="none",
            scalar_output_mode="exclude",
        )
        loss.make_value_estimator(gamma=0.5)
        batch = transitions(column(1.0, 1.0), column(0, 1).bool())
        found, mean = loss.cost_loss(batch)
        torch.testing.assert_close(found, torch.tensor(expected))
        assert mean.item() == pytest.approx(2.5)


def test_the_policy_is_judged_by_both_critics_and_the_price_by_hand() -> None:
    # Q_r = a, Q_c = a + (2, 3), of which the larger counts, lambda = 3, fixed alpha:
    # (a - 3 (a + 3)) / 4 - alpha log pi = -a / 2 - 9 / 4 - alpha log pi
    loss = SACLagrangianLoss(
        make_actor(1, 1, hidden=(4,)),
        make_critic(1, 1, hidden=(4,), ensemble_size=1),
        constant_critic(2.0, size=2),
        LagrangeMultiplier(1.0, initial=3.0),
        alpha_init=0.25,
        fixed_alpha=True,
    )
    with torch.no_grad():
        for parameter in loss.qvalue_network_params.values(True, True):
            parameter.zero_()  # Q_r = 0
        loss.cost_network_params["module", "bias"].copy_(torch.tensor([2.0, 3.0]))
    batch = transitions(column(0.0), column(0).bool())
    torch.manual_seed(1)
    found, metadata = loss.actor_loss(batch)
    torch.manual_seed(1)
    distribution = loss.actor_network.get_dist(batch)
    action = distribution.rsample()
    expected = -(0.0 - 3.0 * (action + 3.0)) / 4.0 + 0.25 * metadata["log_prob"].unsqueeze(-1)
    torch.testing.assert_close(found, expected.mean())


def test_without_a_price_it_is_torchrls_own() -> None:
    torch.manual_seed(0)
    actor, reward, cost = make_actor(3, 2), make_critic(3, 2, ensemble_size=1), make_critic(3, 2)
    constrained = SACLagrangianLoss(actor, reward, cost, LagrangeMultiplier(1.0))
    plain = SACLoss(actor, reward)
    plain.load_state_dict(constrained.state_dict(), strict=False)
    batch = TensorDict(
        observation=torch.randn(4, 3),
        action=torch.rand(4, 2),
        next=TensorDict(
            observation=torch.randn(4, 3),
            reward=torch.randn(4, 1),
            cost=torch.rand(4, 1),
            done=torch.zeros(4, 1).bool(),
            terminated=torch.zeros(4, 1).bool(),
            batch_size=[4],
        ),
        batch_size=[4],
    )
    results = []
    for loss in (constrained, plain):
        torch.manual_seed(2)
        results.append(loss(batch.copy()))
    for key in ("loss_actor", "loss_qvalue", "loss_alpha", "entropy"):
        torch.testing.assert_close(results[0][key], results[1][key])


@pytest.mark.parametrize("gains", [None, (0.2, 0.02, 0.0)])
def test_it_meets_the_limit_where_the_optimum_lies(
    gains: tuple[float, float, float] | None,
) -> None:
    """Two steps, each of reward a and cost a²; a limit of 1/2 on the sum of costs.

    The best policy acts 1/2 in both, for a return of 1, at a price of 1. Critics discount by 1/2:
    a limit that did, too, would allow 0.58 and a sum of costs of 2/3.
    """
    torch.manual_seed(0)
    actor = make_actor(1, 1, hidden=(32,), initial_std=0.5, minimum_std=0.1)
    loss = SACLagrangianLoss(
        actor,
        make_critic(1, 1, hidden=(32,), ensemble_size=1),
        make_critic(1, 1, hidden=(32,)),
        LagrangeMultiplier(0.5, lr=0.02, gains=gains),
        loss_function="l2",
        alpha_init=0.01,
        fixed_alpha=True,
    )
    loss.make_value_estimator(gamma=0.5)
    update = UpdateStep(loss, make_optimizer(loss, lr=1e-2), TargetUpdater(loss, 0.1))
    replay = make_replay_buffer(4000, 64, keys=loss.in_keys, intervention_key=None)
    step = torch.arange(2.0).repeat(16).unsqueeze(-1)  # 16 episodes
    last = step == 1.0
    for _ in range(250):
        with torch.no_grad():
            batch = actor(TensorDict(observation=step, batch_size=[32]))
        action = batch["action"]
        cost = action.square()
        following = {"observation": step + 1, "reward": action, "cost": cost}
        batch["next"] = TensorDict({**following, "done": last, "terminated": last}, [32])
        replay.extend(batch)
        loss.multiplier.update(2.0 * cost.mean())
        for _ in range(2):
            update(replay.sample())
    with torch.no_grad():
        states = torch.arange(2.0).unsqueeze(-1).repeat(500, 1)
        acted = actor(TensorDict(observation=states, batch_size=[1000]))["action"]
    assert 2.0 * acted.square().mean().item() == pytest.approx(0.5, abs=0.09)
    assert 2.0 * acted.mean().item() > 0.9
    assert loss.multiplier.value.item() == pytest.approx(1.0, abs=0.3)


def test_a_batch_without_cost_is_named() -> None:
    loss = SACLagrangianLoss(
        make_actor(1, 1),
        make_critic(1, 1, ensemble_size=1),
        make_critic(1, 1),
        LagrangeMultiplier(1),
    )
    batch = transitions(column(0.0), column(0).bool()).exclude(("next", "cost"))
    with pytest.raises(KeyError, match="needs the entry"):
        loss(batch)


def test_an_unknown_reduction_is_named() -> None:
    networks = make_actor(1, 1), make_critic(1, 1, ensemble_size=1), make_critic(1, 1)
    with pytest.raises(ValueError, match="target_reduction must be"):
        SACLagrangianLoss(*networks, LagrangeMultiplier(1), target_reduction="least")  # type: ignore[arg-type]


def test_formulas_by_hand() -> None:
    value, cost = column(2.0, -1.0), column(1.0, 0.5)
    torch.testing.assert_close(functional.penalised_value(value, cost, 3.0), column(-0.25, -0.625))
    torch.testing.assert_close(functional.shaped_reward(value, cost, 5.0), column(-3.0, -3.5))
