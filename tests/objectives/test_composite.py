"""The composite: which terms it takes, what it shares, how it is built from a description."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch
from torch import nn

from haim_torchrl.modules import Temperature, make_actor, make_critic
from haim_torchrl.objectives import (
    ActorLoss,
    BoundedPreferenceLoss,
    CostCriticLoss,
    ExplicitInterventionLoss,
    HAIMLoss,
    ImplicitInterventionLoss,
    LinearPreferenceLoss,
    LossTerm,
    ProxyQLoss,
    TemperatureLoss,
    build_loss,
)

ALL = {
    "proxy": ProxyQLoss,
    "preference": LinearPreferenceLoss,
    "explicit": ExplicitInterventionLoss,
    "implicit": ImplicitInterventionLoss,
    "temperature": TemperatureLoss,
    "actor": ActorLoss,
}


def small_critic() -> Any:
    return make_critic(5, 2, hidden=(8,))


def small_actor() -> Any:
    return make_actor(5, 2, hidden=(8,))


class Counter:
    """Counts the calls of a function."""

    def __init__(self, function: Any) -> None:
        self.function, self.calls = function, 0

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        self.calls += 1
        return self.function(*args, **kwargs)


def test_shared_work_is_done_once(method: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    policy = Counter(method.actor.get_dist)
    monkeypatch.setattr(method.actor, "get_dist", policy)
    network = method.critics["proxy"].module
    embed, evaluate = Counter(network.embed), Counter(network.evaluate)
    monkeypatch.setattr(network, "embed", embed)
    monkeypatch.setattr(network, "evaluate", evaluate)
    method.loss(method.batch)
    assert policy.calls == 2  # now and next, for six terms
    assert embed.calls == 2  # online now, target next
    assert evaluate.calls == 4  # executed = mentor's, proposed, fresh, and the target's next


@pytest.mark.parametrize("absent", ["preference", "explicit", "implicit", "temperature"])
def test_a_term_left_out_is_absent(method: Any, absent: str) -> None:
    temperature = Temperature()
    terms: dict[str, Any] = {**ALL, absent: None}
    loss = build_loss(terms, small_actor(), small_critic, temperature=temperature)
    loss.make_target_updater()
    assert absent not in loss.terms
    result = loss(method.batch)
    assert not {f"loss_{absent}", f"actor_{absent}"} & set(result.keys())
    assert all(value.isfinite().all() for value in result.values())


def test_build_shares_networks_and_takes_weights_from_the_terms() -> None:
    actor = small_actor()
    temperature = Temperature()
    terms = {
        **ALL,
        "preference": partial(BoundedPreferenceLoss, weight=0.5),
        "explicit": partial(ExplicitInterventionLoss, actor_weight=-3.0, actor_reduction="min"),
    }
    loss = build_loss(terms, actor, small_critic, temperature=temperature)
    parts = loss.terms
    assert parts["proxy"].critic_network is parts["preference"].critic_network
    assert parts["explicit"].critic_network is not parts["implicit"].critic_network
    assert all(t.actor_network is actor for t in parts.values() if hasattr(t, "actor_network"))
    assert parts["actor"].weight_explicit.item() == -3.0
    assert parts["actor"].weight_proxy.item() == 1.0
    assert parts["actor"].weight_implicit.item() == -1.0
    assert parts["preference"].weight.item() == 0.5
    assert parts["actor"].temperature is temperature


def test_build_takes_a_second_cost_critic_without_knowing_it(method: Any) -> None:
    energy = partial(CostCriticLoss, label="energy", actor_weight=-0.5)
    terms = {k: v for k, v in ALL.items() if k != "actor"}
    terms = {**terms, "energy": energy, "actor": ActorLoss}
    loss = build_loss(terms, small_actor(), small_critic, temperature=Temperature())
    loss.make_target_updater()
    batch = method.batch.set(("next", "cost"), torch.ones(8, 1))
    assert {"loss_energy", "actor_energy"} <= set(loss(batch).keys())


def test_build_names_what_it_cannot_hand_out() -> None:
    class Picky(LossTerm):
        def __init__(self, actor_network: nn.Module, horizon: int) -> None:
            raise AssertionError

    with pytest.raises(ValueError, match=r"'picky'.*'horizon'"):
        build_loss({"picky": Picky}, small_actor(), small_critic)


def test_two_actors_are_refused() -> None:
    proxy = ProxyQLoss(small_actor(), small_critic())
    explicit = ExplicitInterventionLoss(small_actor(), small_critic())
    with pytest.raises(ValueError, match=r"'proxy' and 'explicit' follow different actors"):
        HAIMLoss({"proxy": proxy, "explicit": explicit})


def test_two_terms_of_one_name_are_refused() -> None:
    actor = small_actor()
    terms = {name: ExplicitInterventionLoss(actor, small_critic()) for name in ("one", "two")}
    with pytest.raises(ValueError, match=r"'one' and 'two' both write 'loss_explicit'"):
        HAIMLoss(terms)


def test_no_terms_and_no_critics_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one loss term"):
        HAIMLoss({})
    with pytest.raises(ValueError, match="at least one critic"):
        ActorLoss(small_actor(), {})


def test_a_fixed_temperature_cannot_be_tuned() -> None:
    with pytest.raises(TypeError, match="learnable"):
        TemperatureLoss(small_actor(), Temperature(0.1, learnable=False))


def test_every_parameter_is_in_one_group(method: Any) -> None:
    groups = method.loss.parameter_groups(1e-3, temperature={"lr": 1e-2})
    ids = [id(parameter) for group in groups for parameter in group["params"]]
    assert sorted(ids) == sorted({id(parameter) for parameter in method.loss.parameters()})
    rates = {group["name"]: group["lr"] for group in groups}
    assert rates == {"critic": 1e-3, "temperature": 1e-2, "actor": 1e-3}


def test_a_group_of_no_term_is_refused(method: Any) -> None:
    with pytest.raises(ValueError, match="'world_model'"):
        method.loss.parameter_groups(world_model={"lr": 1.0})
