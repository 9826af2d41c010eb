"""The training recipe from end to end."""

from __future__ import annotations

import csv
import json
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import pytest
import torch
from omegaconf import OmegaConf

FRAMES = 600


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


def same(first: Any, second: Any) -> bool:
    if isinstance(first, dict):
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(first, (list, tuple)):
        return len(first) == len(second) and all(map(same, first, second))
    if isinstance(first, torch.Tensor):
        return torch.equal(first, second)
    return bool(first == second)


def test_a_run_leaves_everything(trained: Any) -> None:
    folder = trained.folder
    for name in ("config.yaml", "metrics.json", "train.csv", "validation.csv"):
        assert (folder / name).stat().st_size > 0, name
    for name in ("curves.png", "top_view.png", "platoon.png"):
        assert imageio.imread(folder / name).shape[1] > 500, name
    assert len(imageio.imread(folder / "episode.gif")) > 3
    assert list((folder / "tensorboard").glob("events*"))
    names = {path.name for path in (folder / "checkpoints").iterdir()}
    assert names == {"last.pt", "best.pt", "policy_0000300.pt", "policy_0000600.pt"}


def test_the_terminal_shows_progress_and_a_table(trained: Any) -> None:
    assert f"{FRAMES}/{FRAMES} steps" in trained.out
    assert "takeover rate" in trained.out and "left" in trained.out
    assert "2 held-out scenarios, no mentor" in trained.out
    assert "disturbance rate" in trained.out and "mentor-driven steps" in trained.out


def test_metrics_name_what_was_measured(trained: Any) -> None:
    metrics = json.loads((trained.folder / "metrics.json").read_text())
    assert metrics["training"]["frames"] == FRAMES
    assert [record["scenario"] for record in metrics["episodes"]] == [20000, 20001]
    assert metrics["test"]["overall"]["success"]["count"] == 2
    assert metrics["test"]["overall"]["takeover_rate"]["value"] == 0.0
    assert metrics["test"]["success_by_block"]
    assert metrics["checkpoint"]["frames"] in (300, FRAMES)
    assert metrics["training"]["peak_memory_mib"] < 2048


def test_rows_add_up(trained: Any) -> None:
    train = rows(trained.folder, "train")
    assert [int(row["frames"]) for row in train] == list(range(100, FRAMES + 1, 100))
    assert int(train[-1]["updates"]) == 50  # a tenth of the 500 steps after the first 100
    mentor_steps = sum(float(row["takeover_rate"]) * 100 for row in train)
    assert mentor_steps == pytest.approx(int(train[-1]["mentor_steps_total"]))
    assert [int(row["frames"]) for row in rows(trained.folder, "validation")] == [300, 600]


def test_settings_are_kept_as_text(trained: Any) -> None:
    config = OmegaConf.load(trained.folder / "config.yaml")
    assert config.name == "smoke" and config.total_frames == FRAMES
    contents = torch.load(trained.folder / "checkpoints" / "last.pt", weights_only=True)
    assert OmegaConf.create(contents["config"]).total_frames == FRAMES


def test_a_resumed_run_is_the_uninterrupted_one(
    trained: Any, tmp_path: Path, command: Callable[..., Any]
) -> None:
    first = command("haim", "preset=smoke", "total_frames=300", "eval.pictures=false")
    assert first.code == 0, first.err
    folder = next((tmp_path / "runs" / "smoke").iterdir())
    refused = command("haim", f"resume={folder}")
    assert refused.code == 2 and "has all its 300 steps already" in refused.err
    second = command("haim", f"resume={folder}", f"total_frames={FRAMES}")
    assert second.code == 0, second.err
    for name in ("train", "validation"):
        assert rows(folder, name) == rows(trained.folder, name), name
    one, other = (
        torch.load(path / "checkpoints" / "last.pt", weights_only=True)
        for path in (folder, trained.folder)
    )
    for contents in (one, other):
        contents.pop("config")
        for totals in ("totals", "marked"):
            contents["parts"]["log"][totals].pop("seconds")
    for key in other:
        assert same(one[key], other[key]), key
    assert (folder / "metrics.json").exists() and (folder / "metrics_600.json").exists()


def test_ctrl_c_saves_and_says_how_to_go_on(
    tmp_path: Path, starter: Callable[..., subprocess.Popen[str]], command: Callable[..., Any]
) -> None:
    process = starter(tmp_path, "haim", "preset=smoke", "total_frames=100000", "logger=csv")
    table = "runs/smoke/*/train.csv"
    deadline = time.monotonic() + 240
    while not list(tmp_path.glob(table)):
        assert process.poll() is None and time.monotonic() < deadline, process.communicate()
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=240)
    folder = next((tmp_path / "runs" / "smoke").iterdir())
    assert process.returncode == 130
    assert "stopping after this batch" in err and "Traceback" not in err
    said = next(line for line in out.splitlines() if line.startswith("saved; go on with"))
    assert said.endswith(f"recipes/haim.py resume={folder}")
    saved = torch.load(folder / "checkpoints" / "last.pt", weights_only=True)["frames"]
    assert saved >= 100
    total = -(-(saved + 50) // 50) * 50
    resumed = command(
        "haim", f"resume={folder}", f"total_frames={total}", "eval.pictures=false",
        "eval.checkpoint=last", "train.validate_every=0",
    )  # fmt: skip
    assert resumed.code == 0, resumed.err
    assert int(rows(folder, "train")[-1]["frames"]) == total


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["loss.typo=1"], "Could not override 'loss.typo'"),
        (["loss=nothing"], "Could not find 'loss/nothing'"),
        (["total_frames=many"], "'many' of type 'str' could not be converted to Integer"),
        (["eval.test.start=10"], "eval.train and eval.test share the scenarios 10 to 11"),
        (["loss.implicit.cost.threshold=-9"], "brakes with no more than -8"),
        (["+env.wheels=3"], "unknown setting 'wheels'"),
        (["resume=nowhere"], "checkpoint nowhere does not exist"),
        (["actor.hidden=[-1]"], "make_actor cannot be built"),
        (["switch.switch.collision=false", "switch.switch.departure=false",
          "switch.switch.max_lateral_acceleration=null", "switch.switch.max_stalled_steps=null"],
         "every limit of RiskSwitch is off"),
    ],
)  # fmt: skip
def test_bad_settings_are_one_sentence_and_leave_nothing(
    arguments: list[str], words: str, command: Callable[..., Any], tmp_path: Path
) -> None:
    outcome = command("haim", "preset=smoke", *arguments)
    assert outcome.code == 2
    assert words in outcome.err
    lines = outcome.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert list(tmp_path.rglob("*.*")) == []


def test_a_mentor_that_never_takes_over_stops_the_run(command: Callable[..., Any]) -> None:
    outcome = command("haim", "preset=smoke", "switch=never", "train.no_takeover_after=100")
    assert outcome.code == 1
    assert "no takeover happened in the first 100 steps" in outcome.err


def test_nan_names_the_tensor_and_keeps_the_checkpoint(
    tmp_path: Path, command: Callable[..., Any]
) -> None:
    arguments = ("preset=smoke", "total_frames=150", "train.checkpoint_every=50",
                 "train.validate_every=0", "eval.checkpoint=last", "eval.pictures=false",
                 "eval.test.count=1", "eval.train.count=5")  # fmt: skip
    assert command("haim", *arguments).code == 0
    folder = next((tmp_path / "runs" / "smoke").iterdir())
    last = folder / "checkpoints" / "last.pt"
    contents = torch.load(last, weights_only=True)
    critic = [key for key in contents["parts"]["loss"] if "proxy" in key and "weight" in key]
    assert critic
    for key in critic:
        contents["parts"]["loss"][key].fill_(float("nan"))
    torch.save(contents, last)
    before = last.read_bytes()
    outcome = command("haim", f"resume={folder}", "total_frames=300")
    assert outcome.code == 1
    assert "'loss_proxy_q' is nan" in outcome.err and str(last) in outcome.err
    assert last.read_bytes() == before


@pytest.mark.parametrize("content", [b"nothing", b""])
def test_a_foreign_checkpoint_is_refused_and_left_alone(
    content: bytes, tmp_path: Path, command: Callable[..., Any]
) -> None:
    folder = tmp_path / "other" / "checkpoints"
    folder.mkdir(parents=True)
    (folder / "last.pt").write_bytes(content)
    outcome = command("haim", "preset=smoke", f"resume={folder.parent}")
    assert outcome.code == 2 and "damaged or was not written by this project" in outcome.err
    assert (folder / "last.pt").read_bytes() == content


def test_a_policy_alone_cannot_be_resumed(trained: Any, command: Callable[..., Any]) -> None:
    outcome = command("haim", f"resume={trained.folder / 'checkpoints' / 'best.pt'}")
    assert outcome.code == 2 and "holds a policy only" in outcome.err


def test_resume_does_not_exchange_parts(trained: Any, command: Callable[..., Any]) -> None:
    outcome = command("haim", f"resume={trained.folder}", "total_frames=900", "replay=uniform")
    assert outcome.code == 2
    assert "replay=uniform cannot be combined with resume" in outcome.err


def test_no_run_writes_into_another_ones_folder(trained: Any, command: Callable[..., Any]) -> None:
    outcome = command("haim", "preset=smoke", f"hydra.run.dir={trained.folder}")
    assert outcome.code == 1 and "nothing is overwritten" in outcome.err
