"""Cloning and conservative Q-learning: values by hand, and small problems with a known answer."""

from __future__ import annotations

import math
import warnings

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.distributions import Independent, Uniform
from torch.optim import Adam
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import BCLoss

from haim_torchrl.modules import make_actor, make_critic
from haim_torchrl.objectives import ConservativeQLoss, TargetUpdater, UpdateStep
from haim_torchrl.objectives.functional import conservative_penalty, shaped_reward

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")
LN2, LN3 = math.log(2.0), math.log(3.0)


def test_penalty_by_hand() -> None:
    values = torch.tensor([[0.0, math.log(4.0)]])
    densities = torch.tensor([[-LN2, 0.0]])  # e^(0 + ln 2) + e^(ln 4) = 6
    found = conservative_penalty(values, densities, torch.tensor([[1.0]]))
    assert found.item() == pytest.approx(math.log(6.0) - 1.0)
    # At T = 2 the terms are sqrt(2) and 2, and the logarithm counts twice.
    found = conservative_penalty(values, densities, torch.tensor([[1.0]]), temperature=2.0)
    assert found.item() == pytest.approx(2.0 * math.log(math.sqrt(2.0) + 2.0) - 1.0)


def test_penalty_wants_one_value_per_transition() -> None:
    with pytest.raises(ValueError, match="value must hold one number"):
        conservative_penalty(torch.zeros(3, 2), torch.zeros(3, 2), torch.zeros(3))


def test_a_collision_takes_reward_away() -> None:
    found = shaped_reward(torch.tensor([[2.0], [2.0]]), torch.tensor([[0.0], [1.0]]), 5.0)
    assert found.tolist() == [[2.0], [-3.0]]


class EvenPolicy(nn.Module):
    """Bounds of a uniform distribution, from parameters that are zero."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.shift = nn.Parameter(torch.zeros(size))

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        low = torch.full((*observation.shape[:-1], len(self.shift)), -1.0) + self.shift
        return low, low + 2.0


def even_actor(size: int) -> ProbabilisticActor:
    """Draws every action in [-1, 1] alike: its density is 2^-A."""
    return ProbabilisticActor(
        TensorDictModule(EvenPolicy(size), ["observation"], ["low", "high"]),
        in_keys=["low", "high"],
        distribution_class=lambda low, high: Independent(
            Uniform(low, high, validate_args=False), 1
        ),
    )


class SameValue(nn.Module):
    """A critic that values everything alike."""

    def __init__(self) -> None:
        super().__init__()
        self.value = nn.Parameter(torch.zeros(()))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return self.value.expand(*action.shape[:-1], 1)


def transitions(size: int, actions: int = 2) -> TensorDict:
    ended = torch.ones(size, 1, dtype=torch.bool)
    return TensorDict(
        {
            "observation": torch.randn(size, 3),
            "action": torch.rand(size, actions) * 1.8 - 0.9,
            "next": {
                "observation": torch.randn(size, 3),
                "reward": torch.zeros(size, 1),
                "done": ended,
                "terminated": ended,
            },
        },
        batch_size=[size],
    )


@pytest.mark.parametrize("draws", [1, 4])
def test_penalty_of_a_constant_critic_by_hand(draws: int) -> None:
    """Q = c everywhere and all actions alike: T ln K + A ln 2 of each of two critics, less 0."""
    critic = TensorDictModule(SameValue(), ["observation", "action"], ["state_action_value"])
    loss = ConservativeQLoss(
        even_actor(2), critic, num_random=draws, min_q_weight=0.5, target_entropy=-2.0
    )
    for value in loss.qvalue_network_params.values(True, True):
        assert value.shape == (2,)  # one for each critic
        value.data.fill_(7.0)
    found = loss(transitions(5))["loss_cql"].item()
    assert found == pytest.approx(2 * 0.5 * (math.log(3 * draws) + 2 * LN2), rel=1e-5)
    assert found == pytest.approx({1: LN3, 4: LN3 + 2 * LN2}[draws] + 2 * LN2, rel=1e-5)


def test_while_cloning_the_critics_do_not_move_the_policy() -> None:
    actor = make_actor(3, 2, (16,))
    loss = ConservativeQLoss(actor, make_critic(3, 2, (16,), ensemble_size=1))
    batch, found = transitions(8), {}
    for cloning in (True, False):
        for shift in (0.0, 5.0):
            for parameter in loss.qvalue_network_params.values(True, True):
                parameter.data.add_(shift)
            loss.cloning = cloning
            torch.manual_seed(0)
            found[cloning, shift] = loss(batch.copy())["loss_actor"].item()
    assert found[True, 0.0] == found[True, 5.0]
    assert found[False, 0.0] != found[False, 5.0]


def test_number_of_draws_is_checked() -> None:
    with pytest.raises(ValueError, match="num_random must be at least 1"):
        ConservativeQLoss(make_actor(3, 2), make_critic(3, 2, ensemble_size=1), num_random=0)


def test_cloning_recovers_a_linear_expert() -> None:
    """a = tanh(M s) is a policy that the network can express; held-out states tell."""
    torch.manual_seed(0)
    matrix = torch.tensor([[0.5, -0.3, 0.0], [0.0, 0.4, 0.8]])
    actor = make_actor(3, 2, (32,))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loss = BCLoss(actor, loss_function="l2")
    update = UpdateStep(loss, Adam(loss.parameters(), lr=1e-2))
    for _ in range(400):
        seen = torch.randn(64, 3)
        action = torch.tanh(seen @ matrix.T)
        update(TensorDict({"observation": seen, "action": action}, batch_size=[64]))
    unseen = torch.randn(200, 3)
    found = actor(TensorDict({"observation": unseen}, batch_size=[200]))["action"]
    assert (found - torch.tanh(unseen @ matrix.T)).abs().mean() < 0.05


def test_it_improves_on_the_data_and_stays_near_them() -> None:
    """One step, reward 1 - (a - 0.4)^2 with data in [-0.5, 0.5]: the best of them is 0.4.

    The data's mean action is 0, which is what cloning finds.
    """
    torch.manual_seed(0)
    actor = make_actor(3, 1, (32,))
    loss = ConservativeQLoss(
        actor, make_critic(3, 1, (32,), ensemble_size=1), alpha_init=0.01, fixed_alpha=True,
        min_q_weight=0.02, num_random=2,
    )  # fmt: skip
    loss.make_value_estimator(gamma=0.9)
    update = UpdateStep(loss, Adam(loss.parameters(), lr=1e-2), TargetUpdater(loss, 0.05))
    for _ in range(200):
        batch = transitions(64, actions=1)
        batch["action"] = torch.rand(64, 1) - 0.5
        batch["next", "reward"] = 1.0 - (batch["action"] - 0.4).square()
        update(batch)
    found = actor(TensorDict({"observation": torch.randn(200, 3)}, batch_size=[200]))["action"]
    assert 0.15 < found.mean() < 0.6
