"""The composite: which terms it takes, what it shares, how it is built from a description."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from haim_torchrl.modules import Temperature, make_actor, make_critic
from haim_torchrl.objectives import (
    ActorLoss,
    CostCriticLoss,
    ExplicitInterventionLoss,
    HAIMLoss,
    ImplicitInterventionLoss,
    ProxyQLoss,
    TemperatureLoss,
)


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
    terms = {name: term for name, term in method.loss.named_terms() if name != absent}
    critics = {
        name: (terms[name].critic_network, terms[name].actor_weight, terms[name].actor_reduction)
        for name in ("proxy", "explicit", "implicit")
        if name in terms
    }
    terms["actor"] = ActorLoss(method.actor, critics, method.temperature)
    result = HAIMLoss(terms)(method.batch)
    assert not {f"loss_{absent}", f"actor_{absent}"} & set(result.keys())
    assert {"loss_proxy_q", "loss_actor", "actor_proxy"} <= set(result.keys())
    assert all(value.isfinite().all() for value in result.values())


def test_terms_carry_the_papers_weights_for_the_actor() -> None:
    """psi = beta = phi = 1: the value is maximised, both costs are minimised (eq 25)."""
    actor = small_actor()
    terms = (ProxyQLoss, ExplicitInterventionLoss, ImplicitInterventionLoss)
    carried = [
        (term.actor_weight, term.actor_reduction)
        for term in (kind(actor, small_critic()) for kind in terms)
    ]
    assert carried == [(1.0, "min"), (-1.0, "max"), (-1.0, "max")]


def test_a_further_cost_critic_needs_no_change_of_the_composite(method: Any) -> None:
    energy = CostCriticLoss(method.actor, make_critic(5, 2, (8,)), label="energy")
    terms = dict(method.loss.named_terms())
    terms["energy"] = energy
    terms["actor"] = ActorLoss(
        method.actor, {"energy": (energy.critic_network, -0.5, "max")}, method.temperature
    )
    loss = HAIMLoss(terms)
    loss.make_target_updater()
    batch = method.batch.set(("next", "cost"), torch.ones(8, 1))
    assert {"loss_energy", "actor_energy", "energy_mean"} <= set(loss(batch).keys())
    with pytest.raises(KeyError, match=r"CostCriticLoss needs the entry .*cost"):
        loss(batch.exclude(("next", "cost")))


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
