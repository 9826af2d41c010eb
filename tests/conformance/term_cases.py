"""The cases of single terms; a new term, or a new option of one, gets a case here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import LossModule

from haim_torchrl.objectives import (
    ActorLoss,
    BoundedPreferenceLoss,
    CloningAnchorLoss,
    ConservativePreferenceLoss,
    CostCriticLoss,
    EnsembleCloningLoss,
    ExplicitInterventionLoss,
    ImplicitInterventionLoss,
    LinearPreferenceLoss,
    ProxyQLoss,
    TemperatureLoss,
)

from .loss_case import Discounted, LossCase
from .networks import Networks

ACTOR, CRITIC = ("actor_network_params",), ("critic_network_params",)
WEIGHTED: dict[str, NestedKey] = {"priority_weight": "priority_weight"}
VALUED = {**WEIGHTED, "action": "action", "state_action_value": "state_action_value"}
BOOTSTRAPPED = {
    **VALUED,
    "terminated": "terminated",
    "priority": "td_error",
    "steps_to_next_obs": "steps_to_next_obs",
}
NOW_AND_NEXT: frozenset[NestedKey] = frozenset(
    {"observation", ("next", "observation"), ("next", "terminated")}
)


def marked(entry: str) -> Callable[[TensorDictBase], Tensor]:
    """The transitions that an entry marks."""
    return lambda batch: batch[entry]


def unmarked(entry: str) -> Callable[[TensorDictBase], Tensor]:
    """The transitions that an entry does not mark."""
    return lambda batch: ~batch[entry]


def make_proxy(networks: Networks, **options: Any) -> LossModule:
    """The proxy critic's loss."""
    critic, temperature = networks.critic("proxy"), networks.temperature
    return ProxyQLoss(networks.actor, critic, temperature, reduction=networks.reduction, **options)


PROXY = LossCase(
    "proxy",
    make_proxy,
    losses=("loss_proxy_q",),
    reads=NOW_AND_NEXT | {"action"},
    keys={**BOOTSTRAPPED, "takeover_start": "takeover_start"},
    trains={"loss_proxy_q": CRITIC},
    shares=frozenset({"actor", "proxy", "temperature"}),
    writes=frozenset({"td_error"}),
    targets=("target_critic_network_params",),
    discounted={"loss_proxy_q": Discounted(None, scale=1.0)},
)
PROXY_WITHOUT_STARTS = replace(
    PROXY,
    name="proxy without takeover starts",
    make=lambda networks: make_proxy(networks, takeover_starts=False),
    reads=PROXY.reads | {"takeover_start"},
    mean_over={"loss_proxy_q": unmarked("takeover_start")},
)

LINEAR = LossCase(
    "linear preference",
    lambda n: LinearPreferenceLoss(n.critic("proxy"), reduction=n.reduction),
    losses=("loss_preference",),
    reads=frozenset({"observation", "action", "action_agent", "intervention"}),
    keys={
        **VALUED,
        "action_agent": "action_agent",
        "action_mentor": "action",
        "intervention": "intervention",
    },
    trains={"loss_preference": CRITIC},
    shares=frozenset({"proxy"}),
    draws=False,
    compiled=True,
)
BOUNDED = replace(
    LINEAR,
    name="bounded preference",
    compiled=False,
    make=lambda n: BoundedPreferenceLoss(n.critic("proxy"), reduction=n.reduction),
    mean_over={"loss_preference": marked("intervention")},
)
CONSERVATIVE = replace(
    BOUNDED,
    name="conservative preference",
    make=lambda n: ConservativePreferenceLoss(n.actor, n.critic("proxy"), reduction=n.reduction),
    shares=frozenset({"actor", "proxy"}),
    draws=True,
    compiled=True,
)


def cost_case(
    name: str, kind: type[CostCriticLoss], *, label: str, cost: str, **options: Any
) -> LossCase:
    """A critic of a cost, which names its loss and its priorities by default."""

    def make(networks: Networks) -> LossModule:
        critic = networks.critic(label)
        return kind(networks.actor, critic, reduction=networks.reduction, **options)

    error = f"{label}_td_error"
    return LossCase(
        name,
        make,
        losses=(f"loss_{label}",),
        reads=NOW_AND_NEXT | {"action_agent", ("next", cost)},
        keys={**BOOTSTRAPPED, "action_agent": "action_agent", "cost": cost, "priority": error},
        trains={f"loss_{label}": CRITIC},
        shares=frozenset({"actor", label}),
        writes=frozenset({error}),
        targets=("target_critic_network_params",),
        discounted={f"loss_{label}": Discounted(cost, scale=1.0)},
    )


def disturbance_case(name: str, *, intervened: bool) -> LossCase:
    """The critic of the disturbance, with the mentor's steps or without."""
    kind = ImplicitInterventionLoss
    case = cost_case(name, kind, label="implicit", cost="disturbance_cost", intervened=intervened)
    case = replace(case, keys={**case.keys, "intervention": "intervention"})
    if intervened:
        return case
    own_steps = {"loss_implicit": unmarked("intervention")}
    return replace(case, reads=case.reads | {"intervention"}, mean_over=own_steps)


COST = cost_case("cost", CostCriticLoss, label="cost", cost="cost")
EXPLICIT = cost_case("explicit", ExplicitInterventionLoss, label="explicit", cost="takeover_cost")
EXPLICIT = replace(EXPLICIT, compiled=True)
IMPLICIT = disturbance_case("implicit", intervened=True)
OWN_STEPS = disturbance_case("implicit on the agent's steps", intervened=False)

TEMPERATURE = LossCase(
    "temperature",
    lambda n: TemperatureLoss(n.actor, n.temperature, reduction=n.reduction),
    losses=("loss_temperature",),
    reads=frozenset({"observation"}),
    keys=WEIGHTED,
    trains={"loss_temperature": ("temperature",)},
    shares=frozenset({"actor", "temperature"}),
    ensemble=False,
    compiled=True,
)


def actor_case(*costs: str) -> LossCase:
    """The policy's loss, following the proxy critic and the critics of some costs."""

    def make(networks: Networks) -> LossModule:
        critics: dict[str, tuple[TensorDictModule, float, Any]] = {
            cost: (networks.critic(cost), -1.0, "max") for cost in costs
        }
        critics["proxy"] = (networks.critic("proxy"), 1.0, "min")
        temperature = networks.temperature
        return ActorLoss(networks.actor, critics, temperature, reduction=networks.reduction)

    return LossCase(
        "actor" + "".join(f" and {cost}" for cost in costs),
        make,
        losses=("loss_actor",),
        reads=frozenset({"observation"}),
        keys=VALUED,
        trains={"loss_actor": ACTOR},
        shares=frozenset({"actor", "proxy", "temperature", *costs}),
    )


ANCHOR = LossCase(
    "anchor",
    lambda n: CloningAnchorLoss(n.actor, reduction=n.reduction),
    losses=("loss_anchor",),
    reads=frozenset({"observation", "action", "intervention"}),
    keys={**WEIGHTED, "action_mentor": "action", "intervention": "intervention"},
    trains={"loss_anchor": ACTOR},
    shares=frozenset({"actor"}),
    ensemble=False,
)

ENSEMBLE = LossCase(
    "ensemble cloning",
    lambda n: EnsembleCloningLoss(n.ensemble_actor, reduction=n.reduction),
    losses=("loss_cloning",),
    reads=frozenset({"observation", "action"}),
    keys={
        **WEIGHTED,
        "action": "action",
        "action_members": "action_members",
        "doubt": "doubt",
    },
    trains={"loss_cloning": ACTOR},
    shares=frozenset({"ensemble_actor"}),
    draws=False,
    ensemble=False,
    compiled=True,
)

TERMS = (
    PROXY,
    PROXY_WITHOUT_STARTS,
    LINEAR,
    BOUNDED,
    CONSERVATIVE,
    COST,
    EXPLICIT,
    IMPLICIT,
    OWN_STEPS,
    TEMPERATURE,
    actor_case("explicit", "implicit"),
    ANCHOR,
    ENSEMBLE,
)
