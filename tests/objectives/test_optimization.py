"""Targets, the update step, and the guard against losses that are not finite."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SACLoss

from haim_torchrl.modules import make_actor, make_critic
from haim_torchrl.objectives import (
    LinearPreferenceLoss,
    NonFiniteLossError,
    ProxyQLoss,
    TargetUpdater,
    UpdateStep,
    check_finite,
    make_optimizer,
)


def online_and_targets(loss: Any) -> list[tuple[torch.Tensor, torch.Tensor]]:
    return [
        pair
        for name in ("proxy", "explicit", "implicit")
        for pair in zip(
            loss.terms[name].critic_network_params.values(True, True),
            loss.terms[name].target_critic_network_params.values(True, True),
        )
    ]


def test_targets_start_as_copies(method: Any) -> None:
    pairs = online_and_targets(method.loss)
    assert pairs
    for online, target in pairs:
        torch.testing.assert_close(online.detach(), target)
        assert online.data_ptr() != target.data_ptr()
        assert not target.requires_grad


def test_all_targets_move_by_tau(method: Any) -> None:
    before = [target.clone() for _, target in online_and_targets(method.loss)]
    with torch.no_grad():
        for online, _ in online_and_targets(method.loss):
            online.add_(2.0)
    method.loss.make_target_updater(0.25).step()
    for old, (_, target) in zip(before, online_and_targets(method.loss)):
        torch.testing.assert_close(target, old + 0.5)


def test_targets_still_move_after_a_change_of_type(method: Any) -> None:
    updater = method.loss.make_target_updater(1.0)
    method.loss.to(torch.float64)
    with torch.no_grad():
        for online, _ in online_and_targets(method.loss):
            online.add_(1.0)
    updater.step()
    for online, target in online_and_targets(method.loss):
        torch.testing.assert_close(online.detach(), target)


@pytest.mark.parametrize("tau", [0.0, -0.1, 1.5, float("nan")])
def test_tau_out_of_range_is_refused(method: Any, tau: float) -> None:
    with pytest.raises(ValueError, match="tau must lie in"):
        method.loss.make_target_updater(tau)


def test_a_loss_without_targets_is_refused(make_linear_critic: Any) -> None:
    with pytest.raises(ValueError, match="LinearPreferenceLoss has no target parameters"):
        TargetUpdater(LinearPreferenceLoss(make_linear_critic((1.0, 1.0))))


def test_an_update_trains_everything(method: Any) -> None:
    step = UpdateStep(method.loss, make_optimizer(method.loss, 1e-2), method.updater)
    before = {name: [p.clone() for p in ps] for name, ps in method.parameters().items()}
    targets = [target.clone() for _, target in online_and_targets(method.loss)]
    result = step(method.batch)
    assert not any(value.requires_grad for value in result.values())
    for name, parameters in method.parameters().items():
        for old, new in zip(before[name], parameters):
            assert not torch.equal(old, new), name
    moved = [
        not torch.equal(old, new) for old, (_, new) in zip(targets, online_and_targets(method.loss))
    ]
    assert all(moved)


def test_updates_fit_the_preference(method: Any) -> None:
    """After some steps the mentor's actions are worth more than the rejected ones."""
    step = UpdateStep(method.loss, make_optimizer(method.loss, 1e-2), method.updater)
    first = step(method.batch)["preference_margin"]
    for _ in range(30):
        last = step(method.batch)["preference_margin"]
    assert last > first + 0.5


def test_the_same_seed_gives_the_same_parameters(method_factory: Any) -> None:
    def train() -> list[torch.Tensor]:
        method = method_factory()
        step = UpdateStep(method.loss, make_optimizer(method.loss), method.updater)
        for _ in range(3):
            step(method.batch)
        return [p.detach() for p in method.loss.parameters()]

    for one, two in zip(train(), train()):
        assert torch.equal(one, two)


def test_gradients_can_be_clipped(method: Any) -> None:
    optimizer = torch.optim.SGD(method.loss.parameter_groups(1.0))
    before = [p.clone() for p in method.actor.parameters()]
    UpdateStep(method.loss, optimizer, max_grad_norm=1e-3)(method.batch)
    moved = [(p - old).flatten() for p, old in zip(method.actor.parameters(), before)]
    assert torch.cat(moved).norm().item() == pytest.approx(1e-3, rel=1e-2)


def test_a_clip_of_nothing_is_refused(method: Any) -> None:
    with pytest.raises(ValueError, match="max_grad_norm"):
        UpdateStep(method.loss, make_optimizer(method.loss), max_grad_norm=0.0)


def test_nan_stops_the_update_and_leaves_the_parameters(method: Any) -> None:
    step = UpdateStep(method.loss, make_optimizer(method.loss), method.updater)
    before = [p.clone() for p in method.loss.parameters()]
    method.batch["next", "takeover_cost"][3] = float("nan")
    with pytest.raises(NonFiniteLossError, match="'loss_explicit' is nan") as error:
        step(method.batch)
    assert error.value.name == "loss_explicit"
    for old, new in zip(before, method.loss.parameters()):
        assert torch.equal(old, new)


def test_infinite_losses_are_named() -> None:
    with pytest.raises(NonFiniteLossError, match="'loss_b' is -inf"):
        check_finite(
            TensorDict(
                loss_a=torch.tensor(1.0),
                loss_b=torch.tensor([0.0, float("-inf")]),
                other=torch.tensor(float("nan")),
            )
        )
    check_finite(TensorDict(loss_a=torch.tensor(1.0), other=torch.tensor(float("nan"))))


def test_parameters_of_a_network_are_restored_when_its_call_fails(
    make_known_actor: Any, make_linear_critic: Any, batch: Any
) -> None:
    critic = make_linear_critic((1.0, 1.0))
    term = ProxyQLoss(make_known_actor(), critic)
    TargetUpdater(term)
    weight = critic.module.weight
    with pytest.raises(RuntimeError):
        term(batch.clone().set("action", torch.zeros(3, 4)))
    assert critic.module.weight is weight


def test_torchrls_own_losses_are_grouped_by_network() -> None:
    loss = SACLoss(make_actor(3, 2, (4,)), make_critic(3, 2, (4,), ensemble_size=1))
    optimizer = make_optimizer(loss, lr=0.1, overrides={"temperature": {"lr": 0.5}})
    groups = {group["name"]: group for group in optimizer.param_groups}
    assert {name: group["lr"] for name, group in groups.items()} == {
        "temperature": 0.5,
        "actor": 0.1,
        "critic": 0.1,
    }
    assert groups["temperature"]["params"] == [loss.log_alpha]
    sizes = {name: sum(p.numel() for p in group["params"]) for name, group in groups.items()}
    assert sizes["actor"] == 4 * (3 + 1) + 4 * (4 + 1)  # mean and spread of two actions
    assert sizes["critic"] == 2 * (4 * (5 + 1) + (4 + 1))
    with pytest.raises(ValueError, match="No parameter has the role 'value'"):
        make_optimizer(loss, overrides={"value": {"lr": 1.0}})
