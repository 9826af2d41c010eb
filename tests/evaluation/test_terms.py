"""The loss from its settings: which terms there are, what they share, and what is refused."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.terms import build_loss
from haim_torchrl.modules import make_actor, make_critic
from haim_torchrl.objectives import HAIMLoss
from haim_torchrl.transforms.keys import REPLAY_KEYS

CONF = Path(__file__).parents[2] / "conf"
FULL = {"proxy", "preference", "explicit", "implicit", "actor"}
TERMS = {
    "loss=haim": FULL,
    "loss=haco": FULL - {"implicit"},
    "loss=pvp": FULL - {"implicit", "explicit"},
    "loss=proxy_q": FULL - {"implicit", "explicit"},
    "loss/implicit=none": FULL - {"implicit"},
    "loss/explicit=none": FULL - {"explicit"},
    "loss/preference=none": FULL - {"preference"},
    "loss/preference=linear": FULL,
    "loss/proxy=masked": FULL,
    "loss/entropy=auto": FULL | {"entropy"},
    "loss/anchor=cloning": FULL | {"anchor"},
}


@functools.cache
def _composed(*overrides: str) -> DictConfig:
    GlobalHydra.instance().clear()
    chosen = [f"+{text}" for text in overrides if text.startswith("loss=")] or ["+loss=haim"]
    rest = [text for text in overrides if not text.startswith("loss=")]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose(overrides=chosen + rest).loss


def settings(*overrides: str, **values: Any) -> DictConfig:
    """The group ``loss``; values by their paths with ``__`` for a dot."""
    nested = [f"{key.replace('__', '.')}={value}" for key, value in values.items()]
    config = _composed(*overrides).copy()
    OmegaConf.set_struct(config, False)
    return OmegaConf.merge(config, OmegaConf.from_dotlist(nested))  # type: ignore[return-value]


def built(config: DictConfig, entries: Any = ()) -> HAIMLoss:
    return build_loss(config, make_actor(5, 2), lambda: make_critic(5, 2, (8,)), entries)


@pytest.mark.parametrize("override", TERMS)
def test_loss_has_the_terms_of_its_settings(override: str) -> None:
    config = settings(override)
    loss = built(config, REPLAY_KEYS)
    assert set(loss.terms) == TERMS[override]
    assert loss.terms["proxy"].gamma.item() == pytest.approx(config.gamma)


MEMBERS = [
    path
    for path in sorted((CONF / "loss").glob("*/*.yaml"))
    if path.parent.name != "multiplier"  # a part of the baselines' losses, not a term of this one
]


@pytest.mark.parametrize("path", MEMBERS, ids=lambda p: p.stem)
def test_every_member_of_every_term_builds_a_loss(path: Path) -> None:
    loss = built(settings(f"loss/{path.parent.name}={path.stem}"), REPLAY_KEYS)
    assert (path.parent.name in loss.terms) == (path.stem not in ("none", "fixed"))


def test_terms_that_name_the_same_critic_share_it() -> None:
    made = []

    def critic() -> Any:
        made.append(make_critic(5, 2, (8,)))
        return made[-1]

    loss = build_loss(settings(), make_actor(5, 2), critic)
    assert len(made) == 3
    proxy, preference = loss.terms["proxy"], loss.terms["preference"]
    assert {id(p) for p in preference.trained_parameters()} == {
        id(p) for p in proxy.trained_parameters()
    }


FURTHER_COST = {
    "jerk__term___target_": "haim_torchrl.objectives.CostCriticLoss",
    "jerk__term___partial_": "true",
    "jerk__term__label": "jerk",
    "jerk__critic": "jerk",
    "jerk__keys__cost": "jerk",
}


def test_a_further_cost_needs_only_settings() -> None:
    loss = built(settings(**FURTHER_COST), [*REPLAY_KEYS, ("next", "jerk")])
    assert "loss_jerk" in loss.out_keys and ("next", "jerk") in loss.in_keys
    assert "actor_jerk" in loss.out_keys  # the policy follows it


def test_a_term_whose_entry_nobody_records_is_named_with_it() -> None:
    with pytest.raises(ConfigError, match=r"loss\.jerk \(CostCriticLoss\).*\('next', 'jerk'\)"):
        built(settings(**FURTHER_COST), REPLAY_KEYS)


def test_a_renamed_entry_that_the_term_does_not_know_is_named() -> None:
    with pytest.raises(ConfigError, match=r"loss\.explicit cannot be built: .*price"):
        built(settings(explicit__keys__price="fee"))


def test_a_term_without_its_critic_is_named() -> None:
    with pytest.raises(ConfigError, match=r"loss\.preference takes a critic but names none"):
        built(settings(preference__critic="null"))


def test_a_critic_that_nobody_follows_is_named() -> None:
    with pytest.raises(ConfigError, match=r"loss\.preference trains the critic 'proxy'"):
        built(settings(proxy__term="null"))


def test_a_loss_without_an_actor_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"loss\.actor has no term"):
        built(settings(actor__term="null"))


def test_a_policy_without_any_critic_is_refused() -> None:
    config = settings("loss=proxy_q", "loss/preference=none", proxy__term="null")
    with pytest.raises(ConfigError, match=r"loss\.actor cannot be built: critics must name"):
        built(config)
