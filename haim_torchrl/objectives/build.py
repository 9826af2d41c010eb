"""Builds the composite from a description of its terms."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any

from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules.temperature import Temperature, as_temperature
from haim_torchrl.objectives.actor import WeightedCritic
from haim_torchrl.objectives.composite import HAIMLoss
from haim_torchrl.objectives.temporal_difference import TemporalDifferenceTerm
from haim_torchrl.objectives.term import LossTerm

TermFactory = Callable[..., LossTerm]


def build_loss(
    terms: Mapping[str, TermFactory | None],
    actor_network: ProbabilisticActor,
    make_critic: Callable[[], TensorDictModule],
    *,
    temperature: Temperature | float = 1.0,
    critic_of: Mapping[str, str] | None = None,
) -> HAIMLoss:
    """Builds the composite from factories of its terms, without knowing which terms exist.

    Each factory (a class, or a ``functools.partial`` of one, as Hydra's ``_partial_`` makes) is
    called with those of the following that its signature names: ``actor_network``,
    ``temperature``, ``critic_network`` (one per name in ``critic_of``, made when first asked for),
    and ``critics``, all critics of the temporal-difference terms before it with the weight and
    reduction that these carry for the actor. So a cost critic that is left out is also left out
    of the actor's objective.

    Args:
        terms: factories by name, in the order of evaluation; ``None`` leaves a term out.
        actor_network: the agent's policy.
        make_critic: makes a new critic.
        temperature: the entropy temperature that all terms share.
        critic_of: name of the critic that a term works on, where it is not the term's own name.
            By default the preference works on the critic of the term ``proxy``.

    Returns:
        The composite.

    Raises:
        ValueError: if a factory has a parameter without default that is none of these.

    Examples:
        >>> from haim_torchrl.modules import make_actor, make_critic
        >>> from haim_torchrl.objectives import ActorLoss, LinearPreferenceLoss, ProxyQLoss
        >>> terms = {"proxy": ProxyQLoss, "preference": LinearPreferenceLoss, "explicit": None}
        >>> terms["actor"] = ActorLoss
        >>> loss = build_loss(terms, make_actor(3, 2), lambda: make_critic(3, 2))
        >>> list(loss.terms)
        ['proxy', 'preference', 'actor']
    """
    shared = as_temperature(temperature)
    owners = {"preference": "proxy"} if critic_of is None else dict(critic_of)
    networks: dict[str, TensorDictModule] = {}
    critics: dict[str, WeightedCritic] = {}
    built: dict[str, LossTerm] = {}
    for name, factory in terms.items():
        if factory is None:
            continue
        arguments: dict[str, Any] = {}
        for parameter in _open_parameters(factory):
            if parameter.name == "actor_network":
                arguments["actor_network"] = actor_network
            elif parameter.name == "temperature":
                arguments["temperature"] = shared
            elif parameter.name == "critics":
                arguments["critics"] = dict(critics)
            elif parameter.name == "critic_network":
                owner = owners.get(name, name)
                if owner not in networks:
                    networks[owner] = make_critic()
                arguments["critic_network"] = networks[owner]
            elif parameter.default is inspect.Parameter.empty:
                raise ValueError(
                    f"The term {name!r} asks for {parameter.name!r}; only actor_network, "
                    "critic_network, critics and temperature are handed out, so set it in the "
                    "term's own configuration."
                )
        term = built[name] = factory(**arguments)
        if isinstance(term, TemporalDifferenceTerm):
            critics[name] = WeightedCritic(
                term.critic_network, term.actor_weight, term.actor_reduction
            )
    return HAIMLoss(built)


def _open_parameters(factory: TermFactory) -> list[inspect.Parameter]:
    """Parameters that the factory's own configuration has not set."""
    preset = set(getattr(factory, "keywords", {}))
    skipped = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    parameters = inspect.signature(factory).parameters.values()
    return [p for p in parameters if p.kind not in skipped and p.name not in preset]
