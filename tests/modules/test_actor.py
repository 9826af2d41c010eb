"""The policy: bounds, spread, determinism, the keys it reads and writes."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded, Unbounded
from torchrl.envs.utils import ExplorationType, set_exploration_type

from haim_torchrl.modules import ActorMLP, make_actor


def observe(*batch: int, size: int = 4) -> TensorDict:
    return TensorDict(observation=torch.randn(*batch, size), batch_size=batch)


def test_actions_lie_within_bounds_and_differ() -> None:
    actor = make_actor(4, 2, (16,))
    with set_exploration_type(ExplorationType.RANDOM):
        actions = actor(observe(1000))["action"]
    assert actions.shape == (1000, 2)
    assert actions.abs().max() <= 1.0
    assert actions.std(0).min() > 0.3


def test_deterministic_actions_are_the_squashed_mean() -> None:
    actor = make_actor(4, 2, (16,))
    data = observe(5)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        first = actor(data)["action"]
        torch.testing.assert_close(actor(data)["action"], first)
    torch.testing.assert_close(first, data["loc"].tanh())


def test_log_densities_are_written_on_request_only() -> None:
    assert "action_log_prob" not in make_actor(4, 2)(observe(3))
    assert make_actor(4, 2, return_log_prob=True)(observe(3))["action_log_prob"].shape == (3,)


def test_bounds_come_from_the_spec() -> None:
    spec = Bounded(torch.tensor([0.0, -2.0]), torch.tensor([1.0, 4.0]), shape=(2,))
    actor = make_actor(4, action_spec=spec)
    with set_exploration_type(ExplorationType.RANDOM):
        actions = actor(observe(2000))["action"]
    assert spec.is_in(actions[0]) and (actions >= spec.low).all() and (actions <= spec.high).all()
    assert actions[:, 0].min() < 0.2 and actions[:, 1].max() > 3.0


def test_the_batch_of_a_vectorised_spec_is_dropped() -> None:
    spec = Bounded(-1.0, 1.0, shape=(8, 2))
    assert make_actor(4, action_spec=spec)(observe(8))["action"].shape == (8, 2)


def test_an_output_of_zero_has_the_initial_spread() -> None:
    network = ActorMLP(4, 2, (8,), initial_std=0.3)
    nn.init.zeros_(network.layers[-1].weight)
    nn.init.zeros_(network.layers[-1].bias)
    loc, scale = network(torch.randn(5, 4))
    torch.testing.assert_close(loc, torch.zeros(5, 2))
    torch.testing.assert_close(scale, torch.full((5, 2), 0.3), atol=1e-3, rtol=0)


def test_the_spread_is_bounded_below_and_keeps_its_gradient() -> None:
    network = ActorMLP(4, 1, (8,), minimum_std=0.05)
    with torch.no_grad():
        network.layers[-1].weight.zero_()
        network.layers[-1].bias.fill_(-8.0)
    _, scale = network(torch.zeros(1, 4))
    assert 0.05 <= scale.item() < 0.06
    scale.sum().backward()
    assert network.layers[-1].bias.grad[1] > 0.0


def test_orthogonal_policies_start_centred() -> None:
    torch.manual_seed(0)
    actor = make_actor(4, 2, initialisation="orthogonal")
    data = observe(100)
    actor(data)
    assert data["loc"].abs().max() < 0.1


def test_keys_and_encoder() -> None:
    actor = make_actor(
        6,
        2,
        (8,),
        encoder=nn.Flatten(-2),
        in_keys=[("sensors", "lidar")],
        action_key=("agent", "action"),
    )
    data = actor(TensorDict({"sensors": {"lidar": torch.rand(5, 2, 3)}}, batch_size=[5]))
    assert data["agent", "action"].shape == (5, 2)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({}, ValueError, "action_dim"),
        ({"action_dim": 0}, ValueError, "action_dim"),
        ({"action_spec": Unbounded((2,))}, TypeError, "Bounded"),
        ({"action_dim": 3, "action_spec": Bounded(-1, 1, (2,))}, ValueError, "action_dim is 3"),
        ({"action_dim": 2, "minimum_std": 0.0}, ValueError, "minimum_std"),
        ({"action_dim": 2, "initial_std": 1e-5}, ValueError, "initial_std"),
        ({"action_dim": 2, "initialisation": "zeros"}, ValueError, "'zeros'"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        make_actor(4, **arguments)
