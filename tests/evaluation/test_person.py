"""What a person cannot do is refused before a run, in one sentence with the key and the fix."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.data import TakeoverReplayBuffer
from haim_torchrl.evaluation.aftermath import say_how_it_was, show_alone
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.config import ConfigError, check_config
from haim_torchrl.evaluation.drivers import StraightDriver
from haim_torchrl.evaluation.person import check_person, is_person
from haim_torchrl.modules import make_actor

CONF = Path(__file__).parents[2] / "conf"


@functools.cache
def _composed(name: str, *overrides: str) -> DictConfig:
    register()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose(name, list(overrides))


def load(*overrides: str, name: str = "haim") -> DictConfig:
    return _composed(name, *overrides).copy()


@pytest.fixture(autouse=True)
def window_into_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.mark.parametrize("name", ["keyboard", "gamepad", "wheel", "browser"])
def test_people_drive_live_and_ask_for_control(name: str) -> None:
    config = load(f"mentor={name}")
    assert is_person(config)
    check_config(config)
    assert config.collector._target_.endswith(".LiveCollector") and config.collector.pace == 10.0
    assert config.switch._target_.endswith(".RequestSwitch")
    assert config.mentor.fallback._target_.endswith(".Pause")


@pytest.mark.parametrize("overrides", [
    (),
    ("collector=sync", "collector.pace=5"),
    ("mentor/fallback=brake",),
    ("mentor/fallback=expert",),
])  # fmt: skip
def test_what_a_person_can_do_passes(overrides: tuple[str, ...]) -> None:
    check_person(load("mentor=keyboard", *overrides))


def test_a_switch_that_contains_the_request_passes() -> None:
    config = load("mentor=keyboard")
    config.switch = OmegaConf.create(
        {
            "_target_": "haim_torchrl.switches.AnyOf",
            "_args_": [
                {"_target_": "haim_torchrl.switches.RequestSwitch"},
                {"_target_": "haim_torchrl.switches.RiskSwitch"},
            ],
        }
    )
    check_person(config)


@pytest.mark.parametrize("name", ["expert", "tired", "policy", "replay"])
def test_machines_are_no_people_and_pass(name: str) -> None:
    config = load(f"mentor={name}", "switch=shield", "collector=parallel")
    assert not is_person(config)
    check_person(config)


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            ["collector=parallel"],
            "mentor is a person, who drives one vehicle; use collector=live, or collector=sync",
        ),
        (
            ["collector=sync"],
            "mentor is a person, who needs time to see; set collector.pace, in steps per second, "
            "or use collector=live",
        ),
        (
            ["collector.pace=null"],
            "mentor is a person, who needs time to see; set collector.pace, in steps per second, "
            "or use collector=live",
        ),
        (
            ["switch=shield"],
            "mentor is a person, who takes over when they want to; use switch=request, or a "
            "switch that contains it",
        ),
        (
            ["mentor.console.device=tiller"],
            "mentor.console.device=tiller: there is no such device; take keyboard, gamepad or "
            "wheel",
        ),
    ],
)
def test_what_a_person_cannot_do_is_one_sentence(overrides: list[str], said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        check_person(load("mentor=keyboard", *overrides))
    assert str(caught.value) == said


@pytest.mark.parametrize(
    "recipe",
    [
        ("offline",),
        ("demonstrate",),
        ("evaluate", "driver=mentor"),
        ("evaluate", "driver=[random,mentor]"),
    ],
)
def test_people_take_part_in_training_only(recipe: tuple[str, ...]) -> None:
    name, *overrides = recipe
    config = load(*overrides, name=name)
    config.mentor = load("mentor=keyboard").mentor
    with pytest.raises(ConfigError) as caught:
        check_person(config)
    assert str(caught.value) == (
        "mentor is a person, who takes part in recipes/haim.py only; choose another mentor here, "
        "such as mentor=expert"
    )


def test_a_policy_that_a_person_taught_is_evaluated_without_them() -> None:
    config = load("driver=[policy,random]", name="evaluate")
    config.mentor = load("mentor=wheel").mentor
    check_person(config)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others always have a display")
def test_without_a_display_others_are_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ConfigError, match=r"there is no display .*take mentor=browser.*mentor=exp"):
        check_person(load("mentor=keyboard"))


def test_nobody_is_told_or_shown_anything_where_no_person_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, replay = load(), TakeoverReplayBuffer(64, 8)
    say_how_it_was(config, tmp_path, replay, make_actor(3, 2))
    show_alone(config, StraightDriver())
    person = load("mentor=keyboard", "record=false", "eval.show=0")
    say_how_it_was(person, tmp_path, replay, make_actor(3, 2))
    show_alone(person, StraightDriver())
    assert capsys.readouterr().out == "" and list(tmp_path.iterdir()) == []


def test_a_person_watches_the_agent_alone(capsys: pytest.CaptureFixture[str]) -> None:
    """In the window of the run, with its world and pace, without anybody to take over."""
    torch.manual_seed(0)
    config = load("preset=smoke", "mentor=keyboard", "eval.show=2", "env.horizon=5",
                  "collector.pace=100")  # fmt: skip
    show_alone(config, StraightDriver())
    assert capsys.readouterr().out == (
        "the agent drives alone now, 2 times; watch, or quit to go on\n"
    )
