"""All losses that the suite is applied to: this package's, and two of TorchRL's own.

TorchRL's ``SACLoss`` and ``TD3Loss`` show that the suite asks what TorchRL's losses do, and not
only what ours happen to do. A new combination of terms gets a case here, a new term one in
``term_cases.py``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from tensordict import NestedKey
from torchrl.objectives import LossModule, SACLoss, TD3Loss, ValueEstimators

from haim_torchrl.objectives import (
    ConservativeQLoss,
    HAIMLoss,
    LagrangeMultiplier,
    SACLagrangianLoss,
)

from .loss_case import ALL_BUT_TD0, Discounted, LossCase
from .networks import Networks
from .term_cases import (
    ANCHOR,
    BOUNDED,
    CONSERVATIVE,
    COST,
    EXPLICIT,
    IMPLICIT,
    LINEAR,
    OWN_STEPS,
    PROXY,
    PROXY_WITHOUT_STARTS,
    TEMPERATURE,
    TERMS,
    actor_case,
)

Fact = TypeVar("Fact")


def composite(name: str, terms: Mapping[str, LossCase], *, compiled: bool = False) -> LossCase:
    """The case of a composite, which follows from those of its terms."""

    def make(networks: Networks) -> LossModule:
        return HAIMLoss({name: term.make(networks) for name, term in terms.items()})

    parts = list(terms.values())
    return LossCase(
        name,
        make,
        losses=tuple(loss for part in parts for loss in part.losses),
        reads=frozenset().union(*(part.reads for part in parts)),
        keys={
            f"terms.{name}.{role}": key
            for name, case in terms.items()
            for role, key in case.keys.items()
        },
        shares=frozenset().union(*(part.shares for part in parts)),
        writes=frozenset().union(*(part.writes for part in parts)),
        targets=tuple(f"terms.{name}.{t}" for name, case in terms.items() for t in case.targets),
        discounted=_merged(part.discounted for part in parts),
        mean_over=_merged(part.mean_over for part in parts),
        draws=any(part.draws for part in parts),
        compiled=compiled,
    )


def _merged(facts: Iterable[Mapping[str, Fact]]) -> dict[str, Fact]:
    return {name: fact for each in facts for name, fact in each.items()}


COMPOSITES = (
    composite(
        "HAIM-DRL",
        {
            "proxy": PROXY,
            "preference": CONSERVATIVE,
            "explicit": EXPLICIT,
            "implicit": IMPLICIT,
            "temperature": TEMPERATURE,
            "actor": actor_case("explicit", "implicit"),
        },
    ),
    composite(
        "HACO",
        {
            "proxy": PROXY,
            "preference": LINEAR,
            "explicit": EXPLICIT,
            "temperature": TEMPERATURE,
            "actor": actor_case("explicit"),
        },
    ),
    composite("PVP", {"proxy": PROXY, "preference": BOUNDED, "actor": actor_case()}),
    composite(
        "all options",
        {
            "proxy": PROXY_WITHOUT_STARTS,
            "preference": BOUNDED,
            "cost": COST,
            "implicit": OWN_STEPS,
            "actor": actor_case("cost", "implicit"),
            "anchor": ANCHOR,
        },
        compiled=True,
    ),
)


def make_sac(networks: Networks) -> LossModule:
    """Soft actor-critic of TorchRL."""
    return SACLoss(
        networks.actor,
        networks.single_critic,
        num_qvalue_nets=2,
        loss_function="l2",
        alpha_init=networks.alpha,
        deactivate_vmap=networks.one_by_one,
        reduction=networks.reduction,
        # Not reduced, its scalars have no place in the result; TorchRL wants to hear that.
        scalar_output_mode="exclude" if networks.reduction == "none" else None,
    )


def make_td3(networks: Networks) -> LossModule:
    """Twin delayed deep deterministic policy gradient of TorchRL."""
    return TD3Loss(
        networks.deterministic_actor,
        networks.single_critic,
        bounds=(-1.0, 1.0),
        num_qvalue_nets=2,
        loss_function="l2",
        deactivate_vmap=networks.one_by_one,
        reduction=networks.reduction,
    )


REWARDED: frozenset[NestedKey] = frozenset(
    {
        "observation",
        "action",
        ("next", "observation"),
        ("next", "reward"),
        ("next", "done"),
        ("next", "terminated"),
    }
)
#: What is common to TorchRL's own losses, and different from ours.
UPSTREAM: dict[str, Any] = {
    "reads": REWARDED,
    # Without an end of the episode they go on, without other entries they fail somehow.
    "not_missed": REWARDED - {"observation"},
    "writes": frozenset({"td_error"}),
    "error_of_reduction": NotImplementedError,
    "unsupported": (ValueEstimators.GAE, ValueEstimators.MAGAE, ValueEstimators.VTrace),
    "refused_gammas": (),
    "reset_copies_targets": False,
    "checks_critic": False,
}
UPSTREAM_KEYS = {
    "action": "action",
    "state_action_value": "state_action_value",
    "priority": "td_error",
    "reward": "reward",
    "done": "done",
    "terminated": "terminated",
    "priority_weight": "priority_weight",
}
TORCHRL = (
    LossCase(
        "TorchRL's SAC",
        make_sac,
        losses=("loss_actor", "loss_qvalue", "loss_alpha"),
        keys={**UPSTREAM_KEYS, "value": "state_value", "log_prob": "action_log_prob"},
        trains={
            "loss_actor": ("actor_network_params",),
            "loss_qvalue": ("qvalue_network_params",),
            "loss_alpha": ("log_alpha",),
        },
        shares=frozenset({"actor"}),
        targets=("target_qvalue_network_params",),
        discounted={"loss_qvalue": Discounted("reward", scale=2.0)},
        leaves_behind=frozenset({"loc", "scale"}),
        **UPSTREAM,
    ),
    LossCase(
        "TorchRL's TD3",
        make_td3,
        losses=("loss_actor", "loss_qvalue"),
        keys=UPSTREAM_KEYS,
        trains={
            "loss_actor": ("actor_network_params",),
            "loss_qvalue": ("qvalue_network_params",),
        },
        shares=frozenset({"deterministic_actor"}),
        targets=("target_actor_network_params", "target_qvalue_network_params"),
        discounted={"loss_qvalue": Discounted("reward", scale=2.0)},
        **UPSTREAM,
    ),
)


def make_sac_lagrangian(networks: Networks) -> LossModule:
    """Soft actor-critic of TorchRL under a limit on the cost."""
    return SACLagrangianLoss(
        networks.actor,
        networks.single_critic,
        networks.critic("cost"),
        LagrangeMultiplier(limit=0.1, initial=0.5),
        num_qvalue_nets=2,
        loss_function="l2",
        alpha_init=networks.alpha,
        deactivate_vmap=networks.one_by_one,
        reduction=networks.reduction,
        scalar_output_mode="exclude" if networks.reduction == "none" else None,
    )


def make_conservative_q(networks: Networks) -> LossModule:
    """Conservative Q-learning."""
    return ConservativeQLoss(
        networks.actor,
        networks.single_critic,
        num_random=2,
        target_entropy=-2.0,  # "auto" looks for the action under its default name
        loss_function="l2",
        alpha_init=networks.alpha,
        deactivate_vmap=networks.one_by_one,
        reduction=networks.reduction,
        scalar_output_mode="exclude" if networks.reduction == "none" else None,
    )


SAC, _ = TORCHRL
SAC_LAGRANGIAN = replace(
    SAC,
    name="SAC-Lagrangian",
    make=make_sac_lagrangian,
    losses=(*SAC.losses, "loss_cost"),
    reads=SAC.reads | {("next", "cost")},
    keys={**SAC.keys, "cost": "cost"},
    trains={**SAC.trains, "loss_cost": ("cost_network_params",)},
    shares=SAC.shares | {"cost"},
    targets=(*SAC.targets, "target_cost_network_params"),
    discounted={**SAC.discounted, "loss_cost": Discounted("cost", scale=1.0)},
    leaves_behind=frozenset(),
    unsupported=ALL_BUT_TD0,
    compiled=True,
)
CONSERVATIVE_Q = replace(
    SAC,
    name="CQL",
    make=make_conservative_q,
    losses=(*SAC.losses, "loss_cql"),
    keys={
        **UPSTREAM_KEYS,
        "value": "state_value",
        "log_prob": "_log_prob",
        "pred_q1": "pred_q1",
        "pred_q2": "pred_q2",
        "cql_q1_loss": "cql_q1_loss",
        "cql_q2_loss": "cql_q2_loss",
    },
    trains={**SAC.trains, "loss_cql": ("qvalue_network_params",)},
    leaves_behind=frozenset(),
    compiled=True,
)

CASES = (*TERMS, *COMPOSITES, *TORCHRL, SAC_LAGRANGIAN, CONSERVATIVE_Q)


def cases(*, having: str) -> list[LossCase]:
    """The cases of which something can be asked.

    Args:
        having: the fact that must not be empty.
    """
    return [case for case in CASES if getattr(case, having)]
