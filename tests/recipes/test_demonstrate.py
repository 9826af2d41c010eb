"""Recording of demonstrations, on the real world, and what comes back."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir

from haim_torchrl.data.demonstrations import record_demonstrations
from haim_torchrl.envs import make_env
from haim_torchrl.evaluation.assembly import World, build
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.demonstrations import load_demonstrations
from haim_torchrl.mentors.expert import ExpertMentor

pytest.importorskip("minari")
from haim_torchrl.data.minari import card_of, load_minari

CONF = Path(__file__).parents[2] / "conf"
SHORT = ("dataset=platoon/short-v0", "env.horizon=40", "steps=100")


def settings(*overrides: str) -> Any:
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("demonstrate", ["env.horizon=40", *overrides])


@pytest.fixture(autouse=True)
def datasets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Datasets of each test are its own."""
    folder = tmp_path / "datasets"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    return folder


@pytest.fixture
def short(command: Callable[..., Any], datasets: Path) -> Path:
    """Folder of a dataset of 100 steps."""
    outcome = command("demonstrate", *SHORT)
    assert outcome.code == 0, outcome.err
    assert "ExpertMentor: 100 steps, 3 episodes (2 to their end): success 0" in outcome.out
    assert "beware: only 0.00 of the episodes arrive" in outcome.out
    return datasets / "platoon" / "short-v0"


def test_what_was_driven_comes_back(short: Path) -> None:
    loaded = load_minari("platoon/short-v0", make_env(horizon=40))
    config = settings()
    world = World.of(config, "train", takeovers=False)
    driven = record_demonstrations(world, build(config.mentor), 100, world.seeds(), seed=0)
    assert set(loaded.keys(True, True)) == set(driven.keys(True, True))
    for key in driven.keys(True, True):
        assert torch.equal(loaded[key], driven[key]), key
    assert {"cost", "success", "takeover_cost", "disturbance_cost"} < set(loaded["next"].keys())


def test_the_card_says_how_it_was_recorded(short: Path) -> None:
    card = card_of(short)
    assert card["driver"] == "ExpertMentor" and card["observation_view"] == "route"
    assert (card["seed"], card["statistics"]["steps"]) == (0, 100)
    assert card["statistics"]["success"] == card["statistics"]["cost"] == 0.0
    assert "horizon: 40" in card["settings"]
    assert len(card["scenarios"]) == 3 and set(card["scenarios"]) <= set(range(50))


def test_a_dataset_tells_what_it_is_worth(short: Path, capsys: Any) -> None:
    config = settings()
    data = load_demonstrations(str(short), World.of(config, "train", takeovers=False), config)
    assert len(data) == 100
    said = capsys.readouterr().out.strip().splitlines()
    assert len(said) == 2 and "100 steps, 3 episodes" in said[0] and "beware" in said[1]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["env/observation=rays"], "was recorded with env.observation="),
        (["eval.test.start=0", "eval.train.start=500"], "holds scenarios of eval.test, such as"),
        (["eval.validation.start=0", "eval.train.start=500"], "holds scenarios of eval.validation"),
    ],
)
def test_a_dataset_that_does_not_fit_is_refused(
    short: Path, overrides: list[str], words: str
) -> None:
    config = settings(*overrides)
    with pytest.raises(ConfigError, match=words):
        load_demonstrations(str(short), World.of(config, "train", takeovers=False), config)


def test_nothing_is_overwritten(short: Path, command: Callable[..., Any]) -> None:
    before = (short / "data" / "main_data.hdf5").read_bytes()
    outcome = command("demonstrate", *SHORT)
    assert outcome.code == 2 and "nothing is overwritten" in outcome.err
    assert (short / "data" / "main_data.hdf5").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["steps=0"], "steps must be at least 1; got 0"),
        (["dataset=short"], "dataset id 'short' is malformed"),
        (["driver=autopilot"], "driver must be one of mentor, policy, random, straight"),
        (["driver=policy"], "driver=policy needs a policy; give checkpoint="),
        (["checkpoint=runs"], "checkpoint is given, but driver=mentor drives; use driver=policy"),
        (["driver=policy", "checkpoint=away"], "checkpoint away does not exist"),
        (["eval.set=test"], "eval.set is test, but demonstrations are driven in training"),
        (["eval.train.start=20000"], "eval.train and eval.test share the scenarios"),
        (["env/observation=semantic"], "a dataset holds one vector"),
    ],
)
def test_bad_input(
    arguments: list[str], words: str, tmp_path: Path, command: Callable[..., Any]
) -> None:
    outcome = command("demonstrate", *SHORT, *arguments)
    assert outcome.code == 2 and words in outcome.err
    assert len(outcome.err.strip().splitlines()) == 1
    assert not list(tmp_path.rglob("*.hdf5")) and not list(tmp_path.rglob("*.yaml"))


def test_an_action_that_is_no_number_is_named(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(ExpertMentor, "act", lambda *_: torch.tensor([0.0, 2.0]))
    outcome = command("demonstrate", *SHORT)
    assert outcome.code == 2 and "action holds values from 0 to 2, outside" in outcome.err
    assert not list(tmp_path.rglob("*.hdf5"))


def test_an_interruption_keeps_whole_episodes(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, datasets: Path
) -> None:
    act, calls = ExpertMentor.act, []

    def interrupted(*arguments: Any) -> torch.Tensor:
        calls.append(1)
        if len(calls) == 50:  # in the second episode
            signal.raise_signal(signal.SIGINT)
        return act(*arguments)

    monkeypatch.setattr(ExpertMentor, "act", interrupted)
    outcome = command("demonstrate", *SHORT)
    assert outcome.code == 130
    assert "80 steps, 2 episodes (2 to their end)" in outcome.out
    loaded = load_minari("platoon/short-v0")
    assert len(loaded) == 80 and loaded["next", "done"].sum() == 2


def test_a_trained_policy_can_demonstrate(
    trained: Any, command: Callable[..., Any], datasets: Path
) -> None:
    outcome = command("demonstrate", "driver=policy", f"checkpoint={trained.folder}", *SHORT)
    assert outcome.code == 0, outcome.err
    assert card_of("platoon/short-v0")["driver"].startswith("the policy of")
