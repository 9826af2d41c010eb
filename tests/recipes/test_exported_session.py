"""A drive with takeovers as a dataset: what of it is imitated, and what is learned from."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

#: Runs of a few steps.
BRIEF = {
    "bc": ("offline", "preset=offline_smoke", "offline.updates=10"),
    "cql": ("offline", "preset=offline_smoke", "algorithm=cql", "offline.updates=10"),
    "gail": ("on_policy", "preset=on_policy_smoke", "algorithm=gail", "total_frames=100",
             "train.validate_every=0", "eval.checkpoint=last", "eval.test.count=1",
             "eval.pictures=false", "algorithm.discriminator_steps=2"),
}  # fmt: skip


@pytest.mark.parametrize("algorithm", BRIEF)
def test_only_what_the_mentor_did_is_imitated(
    algorithm: str,
    trained: Any,
    command: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("minari")
    from haim_torchrl.data.minari import export_session, load_minari

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    export_session(trained.folder, "mixed-v0")
    data = load_minari("mixed-v0")
    driven = int(data["intervention"].sum())
    assert 0 < driven < len(data)
    recipe, *arguments = BRIEF[algorithm]
    outcome = command(recipe, *arguments, "demonstrations=mixed-v0", "hydra.run.dir=run")
    assert outcome.code == 0, outcome.err
    training = json.loads((Path("run") / "metrics.json").read_text())["training"]
    told = f"dataset mixed-v0: a mentor drove {driven} of {len(data)} steps"
    if algorithm == "cql":  # learns from what came of it, whoever drove
        assert (training["frames"], training["mentor_steps"]) == (len(data), driven)
        assert told not in outcome.out
        return
    assert told in outcome.out
    if algorithm == "bc":
        assert training["frames"] == training["mentor_steps"] == driven
    else:
        assert training["demonstrations"] == driven


@pytest.mark.parametrize("algorithm", ["bc", "gail"])
def test_a_drive_without_a_mentor_is_nothing_to_imitate(
    algorithm: str, command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("minari")
    from haim_torchrl.evaluation import demonstrations

    load = demonstrations.load_demonstrations

    def alone(*arguments: Any) -> Any:
        data = load(*arguments)
        data["intervention"].zero_()
        return data

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    shown = command("demonstrate", "dataset=alone-v0", "env.horizon=30", "steps=40")
    assert shown.code == 0, shown.err
    monkeypatch.setattr(demonstrations, "load_demonstrations", alone)
    recipe, *arguments = BRIEF[algorithm]
    outcome = command(recipe, *arguments, "demonstrations=alone-v0")
    assert outcome.code == 2 and "holds no step that a mentor drove" in outcome.err
