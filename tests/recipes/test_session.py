"""A run writes its session, and the session gives the run back."""

from __future__ import annotations

import csv
import dataclasses
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from haim_torchrl.data import SESSION_FILE, SessionStep, read_session

SHORT = (
    "preset=smoke", "env.horizon=40", "eval.train.count=5", "total_frames=150", "logger=csv",
    "train.learning_starts=20", "train.log_every=50", "train.checkpoint_every=100",
    "train.validate_every=0", "eval.checkpoint=last", "eval.test.count=1", "eval.pictures=false",
)  # fmt: skip


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "train.csv").open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


def steps(folder: Path) -> list[SessionStep]:
    return [dataclasses.replace(step, time=0.0) for step in read_session(folder).steps()]


@pytest.fixture(scope="module")
def recorded(
    tmp_path_factory: pytest.TempPathFactory, starter: Callable[..., subprocess.Popen[str]]
) -> Path:
    """A short run with a checkpoint in the middle of an episode; its folder."""
    where = tmp_path_factory.mktemp("recorded")
    process = starter(where, "haim", *SHORT)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return next((where / "runs" / "smoke").iterdir())


@pytest.fixture
def again(recorded: Path, command: Callable[..., Any], tmp_path: Path) -> Callable[..., Any]:
    """Drives the session again; gives the outcome and the folder of that run, if there is one."""

    def run(*overrides: str) -> tuple[Any, Path | None]:
        session = ("mentor=replay", f"mentor.session={recorded}")
        outcome = command("haim", *SHORT, *session, *overrides)
        return outcome, next((tmp_path / "runs" / "smoke").glob("*"), None)

    return run


def test_a_run_writes_its_session(recorded: Path) -> None:
    session = read_session(recorded)
    assert len(session) == 150
    assert session.header["seed"] == 0
    assert OmegaConf.create(session.header["settings"]).env.horizon == 40
    assert {episode.scenario for episode in session.episodes} <= set(range(5))
    # Cut off by the horizon, or begun anew after the checkpoint at step 100.
    assert [len(episode.steps) for episode in session.episodes] == [40, 40, 20, 40, 10]
    assert sum(step.intervention for step in session.steps()) == int(
        rows(recorded)[-1]["mentor_steps_total"]
    )


def test_the_learning_curve_comes_out_again(recorded: Path, again: Callable[..., Any]) -> None:
    outcome, folder = again()
    assert outcome.code == 0, outcome.err
    assert rows(folder) == rows(recorded)
    assert "loss_preference" in rows(folder)[-1]
    assert steps(folder) == steps(recorded)


def test_another_loss_and_seed_learn_from_the_same_transitions(
    recorded: Path, again: Callable[..., Any]
) -> None:
    outcome, folder = again("loss=pvp", "seed=3")
    assert outcome.code == 0, outcome.err
    assert steps(folder) == steps(recorded)
    first, last = rows(recorded)[-1], rows(folder)[-1]
    for name in ("takeover_cost", "disturbance_cost", "mentor_steps_total", "episodes_total"):
        assert last[name] == first[name], name
    assert last["loss_actor"] != first["loss_actor"]


def test_an_interrupted_replay_is_the_uninterrupted_one(
    recorded: Path, again: Callable[..., Any], command: Callable[..., Any]
) -> None:
    outcome, folder = again("total_frames=100")
    assert outcome.code == 0, outcome.err
    resumed = command("haim", f"resume={folder}", "total_frames=150")
    assert resumed.code == 0, resumed.err
    assert rows(folder) == rows(recorded)
    assert steps(folder) == steps(recorded)


def test_a_resumed_run_goes_on_with_its_session(
    recorded: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    folder = tmp_path / "runs" / "smoke" / "copy"
    first = command("haim", *SHORT, "total_frames=100", f"hydra.run.dir={folder}")
    assert first.code == 0, first.err
    shutil.copy(recorded / SESSION_FILE, folder)  # as if it had crashed 50 steps later
    refused = command("haim", f"resume={folder}", "total_frames=150", "record=false")
    assert refused.code == 2 and "record=False cannot be combined with resume" in refused.err
    second = command("haim", f"resume={folder}", "total_frames=150")
    assert second.code == 0, second.err
    assert steps(folder) == steps(recorded)
    assert rows(folder) == rows(recorded)


@pytest.mark.parametrize(
    ("overrides", "code", "words"),
    [
        (["total_frames=200"], 2, "ends after 150 steps and total_frames is 200; use"),
        (["switch=shield"], 2, "mentor=replay needs switch=request"),
        (["collector=parallel"], 2, "mentor=replay needs collector=sync"),
        (["mentor.session=nowhere"], 2, "session nowhere does not exist"),
        (["mentor.session=null"], 2, "mentor.session has no value"),
        (["train.checkpoint_every=50"], 1, "episode 1, step 10: the episode ends here"),
        (["train.checkpoint_every=150"], 1, "the recorded run began another one here"),
        (["env.horizon=39"], 1, "episode 0, step 39: the episode ends here"),
    ],
)
def test_what_cannot_be_driven_again_is_one_sentence(
    again: Callable[..., Any], overrides: list[str], code: int, words: str
) -> None:
    outcome, _ = again(*overrides)
    assert outcome.code == code, outcome.err
    assert words in outcome.err
    lines = outcome.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")


def test_an_edited_session_is_one_sentence(
    recorded: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    text = (recorded / SESSION_FILE).read_text()
    edited = tmp_path / "edited.jsonl"
    edited.write_text(text.replace('"intervention":true', '"intervention":false', 1))
    outcome = command("haim", *SHORT, "mentor=replay", f"mentor.session={edited}", "switch=request")
    assert outcome.code == 2
    assert "is not as it was written" in outcome.err
    assert len(outcome.err.strip().splitlines()) == 1


def test_a_run_need_not_be_recorded(tmp_path: Path, command: Callable[..., Any]) -> None:
    outcome = command("haim", *SHORT, "total_frames=50", "record=false")
    assert outcome.code == 0, outcome.err
    assert list(tmp_path.rglob("train.csv")) and not list(tmp_path.rglob(SESSION_FILE))


@pytest.mark.parametrize("recipe", ["offline", "demonstrate", "evaluate"])
def test_a_session_drives_nothing_else(
    recorded: Path, recipe: str, command: Callable[..., Any]
) -> None:
    driver = ("driver=mentor",) if recipe == "evaluate" else ()
    outcome = command(recipe, "mentor=replay", f"mentor.session={recorded}", *driver)
    assert outcome.code == 2
    assert "drives the training of recipes/haim.py again and nothing else" in outcome.err
