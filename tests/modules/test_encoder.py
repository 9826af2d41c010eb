"""Networks that see: sizes, scale, and whose loss trains what."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch.nn import functional as F

from haim_torchrl.modules import (
    ImageEncoder,
    PolicyAverage,
    encoder_of,
    make_actor,
    make_critic,
    make_image_actor,
    make_image_critic,
    share_encoder,
)
from haim_torchrl.objectives import ActorLoss, ExplicitInterventionLoss, HAIMLoss, ProxyQLoss
from haim_torchrl.objectives.optimization import UpdateStep, make_optimizer

SHAPES = {"pixels": (5, 21, 21), "state": (1,)}
SMALL = {"hidden": (8,), "channels": (2, 3, 4)}


def seen(count: int) -> dict[str, torch.Tensor]:
    pixels = torch.randint(0, 256, (count, 5, 21, 21), dtype=torch.uint8)
    return {"pixels": pixels, "state": torch.rand(count, 1)}


@pytest.mark.parametrize(
    ("size", "first", "features"),
    [(84, (12, 6), 576), (42, (6, 3), 576), (21, (4, 2), 64), (14, (2, 1), 576)],
)
def test_images_of_all_sizes_end_alike(size: int, first: tuple[int, int], features: int) -> None:
    encoder = ImageEncoder((5, size, size), numbers=2)
    layer = encoder.layers[0]
    assert (layer.kernel_size[0], layer.stride[0]) == first
    assert encoder.features == features + 2
    pixels = torch.zeros(3, 5, size, size, dtype=torch.uint8)
    assert encoder(pixels, torch.zeros(3, 2)).shape == (3, features + 2)


def test_features_are_those_of_the_image_over_255_and_the_numbers() -> None:
    encoder = ImageEncoder((5, 21, 21), numbers=1, channels=(2, 3, 4))
    pixels, state = seen(4).values()
    hidden = pixels.double() / 255
    for layer in (encoder.layers[0], encoder.layers[2], encoder.layers[4]):
        weight, bias = layer.weight.double(), layer.bias.double()
        hidden = F.relu(F.conv2d(hidden, weight, bias, layer.stride))
    hidden = hidden.flatten(1)
    spread = hidden.var(-1, correction=0, keepdim=True)
    hidden = (hidden - hidden.mean(-1, keepdim=True)) / (spread + 1e-5).sqrt()
    expected = torch.cat([hidden, state], -1).float()
    torch.testing.assert_close(encoder(pixels, state), expected)


def test_batches_of_any_shape_are_read_and_left_as_they_are() -> None:
    encoder = ImageEncoder((5, 21, 21), numbers=1, channels=(2, 3, 4))
    pixels, state = seen(6).values()
    before = pixels.clone()
    flat = encoder(pixels, state)
    nested = encoder(pixels.reshape(2, 3, 5, 21, 21), state.reshape(2, 3, 1))
    torch.testing.assert_close(nested.reshape(6, -1), flat)
    torch.testing.assert_close(encoder(pixels[0], state[0]), flat[0])
    assert torch.equal(pixels, before)


def test_a_shared_encoder_is_the_same_memory_and_no_parameter() -> None:
    actor, critic = make_image_actor(SHAPES, 2, **SMALL), make_image_critic(SHAPES, 2, **SMALL)
    names, count = list(actor.state_dict()), len(list(actor.parameters()))
    share_encoder(actor, critic)
    follower, leader = encoder_of(actor), encoder_of(critic)
    assert follower is not None and leader is not None
    assert sorted(actor.state_dict()) == sorted(names)
    assert list(follower.parameters()) == []
    assert len(list(actor.parameters())) == count - 6  # weights and biases of three layers
    data = seen(3)
    with torch.no_grad():
        leader.layers[0].weight.mul_(-2.0)
    torch.testing.assert_close(follower(*data.values()), leader(*data.values()))


def make_loss() -> tuple[HAIMLoss, dict[str, list[torch.Tensor]]]:
    torch.manual_seed(0)
    actor = make_image_actor(SHAPES, 2, **SMALL)
    proxy, explicit = (make_image_critic(SHAPES, 2, **SMALL) for _ in range(2))
    share_encoder(actor, proxy)
    critics = {"proxy": (proxy, 1.0, "min"), "explicit": (explicit, -1.0, "max")}
    loss = HAIMLoss(
        {
            "proxy": ProxyQLoss(actor, proxy, 0.1),
            "explicit": ExplicitInterventionLoss(actor, explicit),
            "actor": ActorLoss(actor, critics, 0.1),
        }
    )
    owners = {"actor": actor, "proxy": proxy, "explicit": explicit}
    return loss, {name: list(network.parameters()) for name, network in owners.items()}


def batch(count: int = 8) -> TensorDict:
    following = {
        **seen(count),
        "terminated": torch.zeros(count, 1, dtype=torch.bool),
        "takeover_cost": torch.rand(count, 1),
    }
    data = {
        **seen(count),
        "action": torch.rand(count, 2),
        "action_agent": torch.rand(count, 2),
        "intervention": torch.zeros(count, 1, dtype=torch.bool),
        "takeover_start": torch.zeros(count, 1, dtype=torch.bool),
        "next": following,
    }
    return TensorDict(data, batch_size=[count])


def test_encoders_are_trained_by_their_critics_alone() -> None:
    """Each loss reaches its own network; the actor's reaches no encoder at all."""
    loss, owners = make_loss()
    loss.make_target_updater()  # else it warns that nobody moves its targets
    losses = loss(batch())
    for name, owner in (("proxy_q", "proxy"), ("explicit", "explicit"), ("actor", "actor")):
        for other, parameters in owners.items():
            gradients = torch.autograd.grad(
                losses[f"loss_{name}"], parameters, retain_graph=True, allow_unused=True
            )
            reached = [gradient is not None for gradient in gradients]
            assert all(reached) if other == owner else not any(reached)
    groups = {group["name"]: group["params"] for group in loss.parameter_groups()}
    assert {id(p) for p in groups["actor"]} == {id(p) for p in owners["actor"]}
    assert all(p.ndim < 4 for p in groups["actor"])  # not a kernel among them


def test_after_an_update_the_actor_sees_as_the_critic_does() -> None:
    loss, _ = make_loss()
    proxy, actor = loss.terms["proxy"], loss.terms["actor"]
    before = proxy.critic_network_params["module", "encoder", "layers", "0", "weight"].clone()
    UpdateStep(loss, make_optimizer(loss, 1e-2), loss.make_target_updater())(batch())
    critics = proxy.critic_network_params["module", "encoder", "layers", "0", "weight"]
    follower = encoder_of(actor.actor_network)
    assert follower is not None
    assert not torch.equal(critics, before)
    assert torch.equal(follower.layers[0].weight, critics)


def test_the_policys_average_averages_what_it_sees_with() -> None:
    actor, critic = make_image_actor(SHAPES, 2, **SMALL), make_image_critic(SHAPES, 2, **SMALL)
    share_encoder(actor, critic)
    average = PolicyAverage(actor, 0.75)
    average.update()
    start = encoder_of(average.actor).layers[0].weight.clone()
    with torch.no_grad():
        encoder_of(critic).layers[0].weight.add_(1.0)
    average.update()
    torch.testing.assert_close(encoder_of(average.actor).layers[0].weight, start + 0.25)


def test_what_does_not_fit_is_refused_in_a_sentence() -> None:
    with pytest.raises(ValueError, match=r"S at least 14, got \(5, 12, 12\)"):
        ImageEncoder((5, 12, 12))
    with pytest.raises(ValueError, match="channels must be three"):
        ImageEncoder((5, 42, 42), channels=(8, 8))
    with pytest.raises(ValueError, match="must have one image"):
        make_image_actor({"state": (3,)}, 2)
    with pytest.raises(TypeError, match="use env/observation=semantic, or actor=tanh_normal"):
        make_image_critic(110, 2)  # type: ignore[arg-type]
    for make in (make_actor, make_critic):
        with pytest.raises(TypeError, match=r"use those for images \(actor=cnn critic=cnn\)"):
            make(SHAPES, 2)  # type: ignore[arg-type]
    wide = make_image_critic(SHAPES, 2, hidden=(8,), channels=(2, 3, 5))
    with pytest.raises(ValueError, match="give both the same channels"):
        share_encoder(make_image_actor(SHAPES, 2, **SMALL), wide)
    with pytest.raises(ValueError, match="must both have one"):
        share_encoder(make_actor(3, 2), wide)
