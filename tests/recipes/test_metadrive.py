"""MetaDrive through the recipes: one engine in each process, in training, validation and test."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("metadrive", reason='pip install "haim-torchrl[metadrive]"')

SMALL = (
    *("env=metadrive", "preset=smoke", "env.horizon=30", "eval.horizon=40", "eval.test.count=1"),
    *("train.learning_starts=40", "collector.frames_per_batch=20", "total_frames=80"),
    *("train.validate_every=80", "train.checkpoint_every=40", "hydra.run.dir=run"),
)


def test_a_run_trains_validates_and_is_tested(command: Callable[..., Any], tmp_path: Path) -> None:
    outcome = command("haim", *SMALL)
    assert outcome.code == 0, outcome.err
    figures = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert figures
    assert (tmp_path / "run" / "validation.csv").exists()
    assert list((tmp_path / "run").rglob("*.png"))


def test_the_mentors_are_measured_beside_each_other(command: Callable[..., Any]) -> None:
    outcome = command(
        "evaluate", "env=metadrive", "driver=mentor", "mentor=metadrive_ppo", "eval.horizon=20",
        "eval.test.count=1", "eval.pictures=false",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
