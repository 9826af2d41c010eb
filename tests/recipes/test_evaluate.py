"""Evaluation recipe."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest


def results(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())


def test_policy_with_and_without_mentor(
    trained: Any, tmp_path: Path, command: Callable[..., Any]
) -> None:
    outcome = command(
        "evaluate", f"checkpoint={trained.folder}", "driver=[policy,policy+mentor]",
        "eval.set=validation",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert "1 validation scenarios" in outcome.out and "policy+mentor" in outcome.out
    folder = next((tmp_path / "runs" / "evaluate").iterdir())
    found = results(folder)
    assert found["scenarios"] == {"start": 10000, "count": 1}
    assert found["checkpoint"].endswith("best.pt")
    alone, helped = found["drivers"]["policy"], found["drivers"]["policy+mentor"]
    assert alone["episodes"][0]["mentor_steps"] == 0
    assert helped["episodes"][0]["mentor_steps"] > 0
    assert (folder / "policy" / "episode.gif").exists()


def test_the_same_policy_drives_the_same_episode(
    trained: Any, tmp_path: Path, command: Callable[..., Any]
) -> None:
    arguments = (f"checkpoint={trained.folder}", "eval.pictures=false")
    for _ in range(2):
        assert command("evaluate", *arguments).code == 0
    first, second = (results(path) for path in (tmp_path / "runs" / "evaluate").iterdir())
    assert first == second
    trained_metrics = results(trained.folder)
    assert first["drivers"]["policy"]["episodes"] == trained_metrics["episodes"]


def test_drivers_that_need_no_checkpoint(tmp_path: Path, command: Callable[..., Any]) -> None:
    outcome = command(
        "evaluate", "driver=[mentor,straight]", "eval.test.count=1", "eval.pictures=false"
    )
    assert outcome.code == 0, outcome.err
    found = results(next((tmp_path / "runs" / "evaluate").iterdir()))
    assert found["drivers"]["mentor"]["episodes"][0]["outcome"] == "success"
    assert found["drivers"]["straight"]["episodes"][0]["outcome"] != "success"


def test_several_processes_find_the_same(tmp_path: Path, command: Callable[..., Any]) -> None:
    arguments = ("driver=straight", "eval.test.count=2", "eval.pictures=false")
    for workers in (1, 2):
        assert command("evaluate", *arguments, f"eval.workers={workers}").code == 0
    first, second = (results(path) for path in (tmp_path / "runs" / "evaluate").iterdir())
    assert first["drivers"] == second["drivers"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["driver=policy"], "driver=policy needs a policy; give checkpoint="),
        (["driver=autopilot"], "driver must be policy, policy+mentor, mentor, random or straight"),
        (["driver=[]"], "driver names nobody"),
        (["checkpoint=nowhere"], "checkpoint nowhere does not exist"),
        (["eval=exam"], "Could not find 'eval/exam'"),
        (["driver=mentor", "eval.validation.start=20000"], "share the scenarios"),
    ],
)
def test_bad_input(
    arguments: list[str], words: str, tmp_path: Path, command: Callable[..., Any]
) -> None:
    outcome = command("evaluate", *arguments)
    assert outcome.code == 2 and words in outcome.err
    assert len(outcome.err.strip().splitlines()) == 1
    assert list(tmp_path.rglob("*.*")) == []


def test_a_policy_of_another_size_is_named(trained: Any, command: Callable[..., Any]) -> None:
    outcome = command("evaluate", f"checkpoint={trained.folder}", "actor.hidden=[8]")
    assert outcome.code == 2 and "does not fit this run's actor" in outcome.err
