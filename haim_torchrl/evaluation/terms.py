"""From the group ``loss`` of the settings to the loss around one actor."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import partial
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor

from haim_torchrl.evaluation.assembly import build
from haim_torchrl.evaluation.config import ConfigError, plain
from haim_torchrl.modules import Temperature, encoder_of, share_encoder
from haim_torchrl.objectives import ActorLoss, HAIMLoss, LossTerm, TemporalDifferenceTerm

SEEING = "proxy"
"""The critic with whose encoder the actor sees."""


def build_loss(
    settings: DictConfig,
    actor: ProbabilisticActor,
    make_critic: Callable[[], TensorDictModule],
    entries: Collection[NestedKey] = (),
) -> HAIMLoss:
    """The loss from its terms' settings.

    Which terms there are is decided by the settings alone. A term is an entry with ``term``, a
    partial that gets, by name, those of ``actor_network``, ``critic_network`` and ``temperature``
    that it takes; terms that name the same ``critic`` share it. ``keys`` renames what it reads
    (``set_keys``). The actor's own term gets the critics of all temporal-difference terms with the
    weights that these carry. An actor with an encoder for images sees with that of the critic
    ``proxy``, which its own loss does not train.

    Args:
        settings: The group ``loss``.
        actor: The actor.
        make_critic: Builds a fresh critic.
        entries: What a transition holds; empty if that is not known.

    Raises:
        ConfigError: If a term cannot be built, takes a critic and names none, trains a critic that
            the policy does not follow, or reads an entry that nobody records.
    """
    if "entropy" not in settings:
        raise ConfigError(
            "loss has none of the terms of a method that learns from takeovers; choose a method, "
            "such as method=haim, or use recipes/off_policy.py"
        )
    temperature: Temperature = build(settings.entropy.temperature)
    temperature.to(next(actor.parameters()).device)
    nodes = dict(_nodes(settings))
    names = dict.fromkeys(node.critic for node in nodes.values() if node.get("critic"))
    critics = {name: make_critic() for name in names}
    if encoder_of(actor) is not None:
        _share_encoder(actor, critics)
    terms: dict[str, LossTerm] = {}
    waiting: dict[str, Callable[..., LossTerm]] = {}
    for name, node in nodes.items():
        make_term = build(node.term)
        accepted = inspect.signature(make_term).parameters
        given: dict[str, Any] = {"actor_network": actor, "temperature": temperature}
        if "critic_network" in accepted:
            if node.get("critic") is None:
                raise ConfigError(
                    f"loss.{name} takes a critic but names none; set loss.{name}.critic"
                )
            given["critic_network"] = critics[node.critic]
        make_term = partial(make_term, **{k: v for k, v in given.items() if k in accepted})
        if "critics" in accepted:
            waiting[name] = make_term
        else:
            terms[name] = _build_term(name, make_term, node)
    followed = {
        name: (term.critic_network, term.actor_weight, term.actor_reduction)
        for name, term in terms.items()
        if isinstance(term, TemporalDifferenceTerm)
    }
    for name, make_term in waiting.items():
        terms[name] = _build_term(name, partial(make_term, critics=followed), settings[name])
    _check(settings, terms, entries)
    try:
        loss = HAIMLoss(terms)
        loss.make_value_estimator(gamma=settings.gamma)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"loss: {error}") from error
    return loss


def _share_encoder(actor: ProbabilisticActor, critics: Mapping[str, TensorDictModule]) -> None:
    if SEEING not in critics:
        raise ConfigError(
            f"an actor that sees images needs the critic {SEEING!r} to train its encoder, and no "
            f"term of loss names it; name it in one, or use networks for vectors"
        )
    try:
        share_encoder(actor, critics[SEEING])
    except ValueError as error:
        raise ConfigError(f"actor and critic do not fit: {error}") from error


def _nodes(settings: DictConfig) -> Iterator[tuple[str, DictConfig]]:
    """The entries of the group that are terms."""
    for name, node in settings.items():
        if OmegaConf.is_dict(node) and node.get("term") is not None:
            yield str(name), node


def _build_term(name: str, make_term: Callable[[], LossTerm], node: DictConfig) -> LossTerm:
    try:
        term = make_term()
        if node.get("keys"):
            term.set_keys(**plain(node["keys"]))
        return term
    except (TypeError, ValueError) as error:
        raise ConfigError(f"loss.{name} cannot be built: {error}") from error


def _check(
    settings: DictConfig, terms: Mapping[str, LossTerm], entries: Collection[NestedKey]
) -> None:
    if not any(isinstance(term, ActorLoss) for term in terms.values()):
        raise ConfigError("loss.actor has no term, so that no policy would be learned; choose one")
    followed = {
        settings[name].critic
        for name, term in terms.items()
        if isinstance(term, TemporalDifferenceTerm)
    }
    for name, term in terms.items():
        critic = settings[name].get("critic")
        if critic is not None and critic not in followed:
            raise ConfigError(
                f"loss.{name} trains the critic {critic!r}, which the policy would not follow, "
                f"as no temporal-difference term has it; leave loss.{name} out, or add such a term"
            )
        for key in term.in_keys if entries else ():
            if key not in entries:
                raise ConfigError(
                    f"loss.{name} ({type(term).__name__}) reads the entry {key!r}, which no "
                    "transition holds; let the environment or a transform write it, or name "
                    f"another one in loss.{name}.keys"
                )
