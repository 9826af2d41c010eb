"""The training recipe with collector=ray."""

from __future__ import annotations

import csv
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from haim_torchrl.collectors import cluster


def test_without_ray_one_sentence_names_the_extra(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: Callable[..., Any]
) -> None:
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    outcome = command("haim", "preset=smoke", "collector=ray")
    assert outcome.code == 2
    assert 'pip install "haim-torchrl[ray]"' in outcome.err and "Traceback" not in outcome.err
    assert not list(tmp_path.glob("runs/smoke/*"))


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is an extra")
def test_a_run_starts_a_ray_of_its_own_and_ends_it(
    tmp_path: Path, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    import ray

    monkeypatch.setenv("RAY_ADDRESS", "10.0.0.1:6379")  # somebody's cluster, which is not meant
    settings = ("total_frames=300", "eval.pictures=false", "eval.test.count=1", "logger=csv")
    outcome = command("haim", "preset=smoke", "collector=ray", *settings)
    assert outcome.code == 0, outcome.err
    assert not ray.is_initialized()
    (folder,) = (tmp_path / "runs").glob("*/*")
    *_, row = csv.DictReader((folder / "train.csv").open())
    assert (row["frames"], row["updates"]) == ("300", "20")  # a tenth of those after 100
    assert len(list(folder.glob("session-*.jsonl"))) == 2  # one for each worker
