"""Critic ensembles: shapes, independence of the members, both ways of evaluating them."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch.nn import functional as F

from haim_torchrl.modules import EnsembleMLP, make_critic


def test_members_are_separate_perceptrons() -> None:
    """The batched products equal one plain perceptron for each member."""
    torch.manual_seed(0)
    critic = EnsembleMLP(3, 2, (8, 4), ensemble_size=3)
    observation, action = torch.randn(6, 3), torch.randn(6, 2)
    values = critic(observation, action)
    inputs = torch.cat([observation, action], -1)
    first = torch.cat([critic.observation_weight, critic.action_weight], -1)
    for member in range(3):
        rows = slice(member * 8, (member + 1) * 8)
        hidden = F.relu(F.linear(inputs, first[rows], critic.input_bias[rows]))
        hidden = F.relu(hidden @ critic.weights[0][member] + critic.biases[0][member])
        expected = hidden @ critic.weights[1][member] + critic.biases[1][member]
        torch.testing.assert_close(values[:, member], expected.squeeze(-1))


def test_members_have_layer_norms_of_their_own() -> None:
    torch.manual_seed(0)
    critic = EnsembleMLP(3, 2, (8, 4), layer_norm=True)
    with torch.no_grad():
        critic.norms[0].weight.uniform_(0.5, 1.5)
        critic.norms[1].bias.uniform_(-1.0, 1.0)
    observation, action = torch.randn(6, 3), torch.randn(6, 2)
    values = critic(observation, action)
    inputs = torch.cat([observation, action], -1)
    first = torch.cat([critic.observation_weight, critic.action_weight], -1)
    for member in range(2):
        rows = slice(member * 8, (member + 1) * 8)
        hidden = F.linear(inputs, first[rows], critic.input_bias[rows])
        norm = critic.norms[0]
        hidden = F.relu(F.layer_norm(hidden, (8,), norm.weight[rows], norm.bias[rows]))
        hidden = hidden @ critic.weights[0][member] + critic.biases[0][member]
        norm = critic.norms[1]
        hidden = F.relu(F.layer_norm(hidden, (4,), norm.weight[member, 0], norm.bias[member, 0]))
        expected = hidden @ critic.weights[1][member] + critic.biases[1][member]
        torch.testing.assert_close(values[:, member], expected.squeeze(-1))


@pytest.mark.parametrize("layer_norm", [False, True])
def test_one_embedding_serves_several_actions(layer_norm: bool) -> None:
    critic = EnsembleMLP(3, 2, (8, 8), layer_norm=layer_norm)
    observation = torch.randn(5, 3)
    embedding = critic.embed(observation)
    before = embedding.clone()
    for _ in range(3):
        action = torch.randn(5, 2)
        torch.testing.assert_close(critic.evaluate(embedding, action), critic(observation, action))
    torch.testing.assert_close(embedding, before)  # in-place operations stay inside


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_any_batch_shape(batch: tuple[int, ...]) -> None:
    critic = EnsembleMLP(3, 2, (8,), ensemble_size=5)
    assert critic(torch.randn(*batch, 3), torch.randn(*batch, 2)).shape == (*batch, 5)


@pytest.mark.parametrize("initialisation", ["default", "orthogonal"])
def test_members_are_drawn_independently(initialisation: str) -> None:
    torch.manual_seed(0)
    critic = EnsembleMLP(6, 2, (16, 16), initialisation=initialisation)
    one, two = critic.observation_weight.chunk(2)
    assert not torch.equal(one, two)
    assert not torch.equal(critic.weights[0][0], critic.weights[0][1])


def test_orthogonal_initialisation_is_orthogonal() -> None:
    critic = EnsembleMLP(6, 2, (8, 8), initialisation="orthogonal")
    first = torch.cat([critic.observation_weight, critic.action_weight], -1)[:8]
    torch.testing.assert_close(first @ first.T, 2.0 * torch.eye(8), atol=1e-5, rtol=0)
    torch.testing.assert_close(
        critic.weights[0][1].T @ critic.weights[0][1], 2.0 * torch.eye(8), atol=1e-5, rtol=0
    )
    assert critic.input_bias.abs().max() == 0.0


def test_default_initialisation_has_the_spread_of_a_linear_layer() -> None:
    critic = EnsembleMLP(60, 4, (256, 256))
    bound = 64**-0.5  # the action counts as input, too
    for weight in (critic.observation_weight, critic.action_weight):
        assert 0.9 * bound < weight.abs().max() <= bound
    assert 0.9 / 16 < critic.weights[0].abs().max() <= 1 / 16


def test_encoder_stands_before_the_ensemble() -> None:
    class Sum(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.gain = nn.Parameter(torch.tensor(2.0))

        def forward(self, pixels: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
            return self.gain * pixels.mean((-1, -2)) + state

    critic = make_critic(
        3, 2, (8,), encoder=Sum(), in_keys=("pixels", "state", "action"), out_key="value"
    )
    pixels, state, action = torch.rand(4, 3, 5, 5), torch.rand(4, 3), torch.rand(4, 2)
    data = critic(TensorDict(pixels=pixels, state=state, action=action))
    plain = critic.module.evaluate(
        F.linear(2.0 * pixels.mean((-1, -2)) + state, critic.module.observation_weight), action
    )
    torch.testing.assert_close(data["value"], plain)
    data["value"].sum().backward()
    assert critic.module.encoder.gain.grad is not None


def test_several_observations_are_joined_without_an_encoder() -> None:
    critic = make_critic(5, 2, (8,), in_keys=("state", "lidar", "action"))
    state, lidar, action = torch.rand(4, 2), torch.rand(4, 3), torch.rand(4, 2)
    values = critic(TensorDict(state=state, lidar=lidar, action=action))["state_action_value"]
    expected = critic.module(torch.cat([state, lidar], -1), action)
    torch.testing.assert_close(values, expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hidden": ()}, "hidden not empty"),
        ({"hidden": (8, 0)}, "at least 1"),
        ({"ensemble_size": 0}, "at least 1"),
        ({"action_dim": 0}, "at least 1"),
        ({"initialisation": "zeros"}, "'zeros'"),
    ],
)
def test_bad_sizes_are_refused(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_critic(**{"observation_dim": 3, "action_dim": 2, **change})
