"""HG-DAgger and IWR from end to end, and what their recipe refuses."""

from __future__ import annotations

import csv
import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.rounds import check_rounds
from haim_torchrl.evaluation.training_log import TrainingLog

CONF = Path(__file__).parents[2] / "conf"
SMOKE = ("preset=dagger_smoke", "logger=csv", "eval.train.count=3")
#: The mentor corrects nearly every action, so that there are takeovers at once.
CORRECTING = ("switch=action", "switch.switch.threshold=0.05")


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


def last(folder: Path) -> dict[str, Any]:
    return torch.load(folder / "checkpoints" / "last.pt", weights_only=True)


def stored(folder: Path) -> tuple[int, int]:
    """How many steps are learned from as the mentor's, and as free ones."""
    replay = last(folder)["parts"]["data"]["replay"]
    sizes = []
    for store in ("intervened", "free"):
        columns = replay[store]["columns"]
        sizes.append(len(columns[0][1]) if columns else 0)
    return sizes[0], sizes[1]


def test_hg_dagger_learns_from_what_the_mentor_drove(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    outcome = command("dagger", *SMOKE, *CORRECTING)
    assert outcome.code == 0, outcome.err
    assert "1 held-out scenarios, no mentor" in outcome.out and "hg_dagger" in outcome.out
    folder = next((tmp_path / "runs" / "hg_dagger").iterdir())
    training = json.loads((folder / "metrics.json").read_text())["training"]
    assert training["frames"] == 200 and training["updates"] == 30
    assert 100 < training["mentor_steps"] <= 200 and training["takeovers"] >= 1
    assert training["doubt_threshold"] > 0.0
    assert stored(folder) == (training["mentor_steps"], 0)
    assert [int(row["frames"]) for row in rows(folder, "train")] == [100, 125, 150, 175, 200]
    first = rows(folder, "train")[0]
    assert float(first["takeover_rate"]) == 1.0 and float(first["doubt"]) > 0.0
    assert [int(row["frames"]) for row in rows(folder, "validation")] == [100, 150, 200]

    alone = command("evaluate", f"checkpoint={folder}", "eval.pictures=false")
    assert alone.code == 0, alone.err


def test_iwr_learns_from_all_and_a_resumed_run_is_the_uninterrupted_one(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    arguments = (*SMOKE, *CORRECTING, "algorithm=iwr")
    whole = command("dagger", *arguments, "name=whole")
    parts = command("dagger", *arguments, "name=parts", "total_frames=150")
    assert whole.code == parts.code == 0, whole.err + parts.err
    folder, other = (next((tmp_path / "runs" / name).iterdir()) for name in ("whole", "parts"))
    refused = command("dagger", f"resume={other}")
    assert refused.code == 2 and "has all its 150 steps already" in refused.err
    resumed = command("dagger", f"resume={other}", "total_frames=200")
    assert resumed.code == 0, resumed.err
    for name in ("train", "validation"):
        assert rows(other, name) == rows(folder, name), name
    first, second = (last(path)["actor"] for path in (folder, other))
    assert all(torch.equal(first[key], second[key]) for key in first)
    training = json.loads((folder / "metrics.json").read_text())["training"]
    assert training["doubt_threshold"] is None
    taken = int(training["mentor_steps"]) - 100
    assert stored(folder) == stored(other) == (taken, 200 - taken)


def test_ctrl_c_amid_the_updates_loses_none(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        counted = TrainingLog.add_losses

        def interrupted(log: TrainingLog, losses: Any) -> None:
            counted(log, losses)
            if log.totals["updates"] == 13:
                signal.raise_signal(signal.SIGINT)

        patch.setattr(TrainingLog, "add_losses", interrupted)
        stopped = command("dagger", *SMOKE, *CORRECTING)
    folder = next((tmp_path / "runs" / "hg_dagger").iterdir())
    assert stopped.code == 130
    assert f"recipes/dagger.py resume={folder}" in stopped.out
    contents = last(folder)
    assert contents["frames"] == 150 and contents["parts"]["log"]["totals"]["updates"] == 13
    assert len(rows(folder, "validation")) == 1

    resumed = command("dagger", f"resume={folder}")
    assert resumed.code == 0, resumed.err
    training = json.loads((folder / "metrics.json").read_text())["training"]
    assert (training["frames"], training["updates"]) == (200, 30)
    assert [int(row["frames"]) for row in rows(folder, "validation")] == [100, 150, 200]


def test_ctrl_c_in_the_last_update_hands_the_new_policy_over(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = command("dagger", *SMOKE, *CORRECTING, "name=whole")
    assert whole.code == 0, whole.err
    with monkeypatch.context() as patch:
        counted = TrainingLog.add_losses

        def interrupted(log: TrainingLog, losses: Any) -> None:
            counted(log, losses)
            if log.totals["updates"] == 20:  # 10 of the warm-up, 10 of the first round
                signal.raise_signal(signal.SIGINT)

        patch.setattr(TrainingLog, "add_losses", interrupted)
        stopped = command("dagger", *SMOKE, *CORRECTING, "name=parts")
    folder, other = (next((tmp_path / "runs" / name).iterdir()) for name in ("whole", "parts"))
    assert stopped.code == 130
    assert [int(row["frames"]) for row in rows(other, "validation")] == [100, 150]
    resumed = command("dagger", f"resume={other}")
    assert resumed.code == 0, resumed.err
    assert rows(other, "validation") == rows(folder, "validation")
    assert rows(other, "train") == rows(folder, "train")


def test_the_warm_up_can_be_a_datasets(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    world = ("env.horizon=100", "eval.train.count=3")
    shown = command("demonstrate", "dataset=shown-v0", "steps=80", *world)
    assert shown.code == 0, shown.err

    few = command("dagger", *SMOKE, "demonstrations=shown-v0")
    assert few.code == 2
    assert "shown-v0 holds 80 demonstrated steps and dagger.warm_up is 100" in few.err
    arguments = ("demonstrations=shown-v0", "dagger.warm_up=75", "total_frames=125")
    outcome = command("dagger", *SMOKE, *arguments, "switch=never")
    assert outcome.code == 0, outcome.err
    assert "beware: no takeover happened" in outcome.out
    folder = next((tmp_path / "runs" / "hg_dagger").iterdir())
    training = json.loads((folder / "metrics.json").read_text())["training"]
    assert training["frames"] == 125 and training["mentor_steps"] == 75


def composed(*overrides: str) -> DictConfig:
    register()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("dagger", list(overrides))


@pytest.mark.parametrize("preset", ["dagger_default", "dagger_paper", "dagger_smoke"])
@pytest.mark.parametrize("algorithm", ["hg_dagger", "iwr"])
def test_presets_pass_the_checks(preset: str, algorithm: str) -> None:
    config = composed(f"preset={preset}", f"algorithm={algorithm}")
    check_rounds(config)
    assert config.name == algorithm


def test_the_papers_preset_is_its_tables() -> None:
    config = composed("preset=dagger_paper")
    settings = config.dagger
    assert (settings.warm_up, settings.interactions) == (30_000, 5000)
    assert (config.total_frames - settings.warm_up) / settings.interactions == 4
    assert (settings.batch_size, settings.lr) == (256, 4e-4)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["total_frames=29000"], "use total_frames=25000"),
        (["total_frames=10000"], "use total_frames=15000"),
        (["dagger.updates=0"], "dagger.updates must be at least 1"),
        (["dagger.warm_up=0"], "dagger.warm_up must be at least 1"),
        (["dagger.lr=0"], "dagger.lr must be positive"),
        (["dagger.keep=some"], "dagger.keep must be mentor or all"),
        (["collector.frames_per_batch=300"], "must divide dagger.interactions"),
        (["replay.capacity=20000"], "replay.capacity .20000. must be at least total_frames"),
        (["replay.mentor_capacity=5"], "replay.mentor_capacity .5. must be at least"),
    ],
)
def test_contradictions_are_named(overrides: list[str], words: str) -> None:
    config = OmegaConf.merge(composed(), OmegaConf.from_dotlist(overrides))
    with pytest.raises(ConfigError, match=words):
        check_rounds(config)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["total_frames=190"], "use total_frames=150"),
        (["collector=live"], "use collector=sync"),
        (["demonstrations=nowhere-v0"], "nowhere-v0"),
        (["actor.members=1"], "members must be at least 2"),
        (["actor=tanh_normal"], "EnsembleCloningLoss"),
        (["mentor=keyboard"], "mentor is a person"),
    ],
)
def test_bad_settings_are_one_sentence_and_leave_nothing(
    arguments: list[str], words: str, command: Callable[..., Any], tmp_path: Path
) -> None:
    outcome = command("dagger", *SMOKE, *arguments)
    assert outcome.code == 2
    assert words in outcome.err
    lines = outcome.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert list(tmp_path.rglob("*.*")) == []
