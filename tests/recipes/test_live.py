"""Training while the environment is driven in a process of its own."""

from __future__ import annotations

import csv
import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from haim_torchrl.data import SessionStep, read_session

SHORT = (
    "preset=smoke", "env.horizon=40", "eval.train.count=5", "total_frames=100", "logger=csv",
    "collector=live", "collector.frames_per_batch=10", "collector.pace=null",
    "train.learning_starts=20", "train.log_every=50", "train.checkpoint_every=50",
    "train.validate_every=0", "eval.checkpoint=last", "eval.test.count=1", "eval.pictures=false",
)  # fmt: skip
# A policy that has learned nothing hardly moves; these shields soon call that standing.
SHIELD = ("switch=shield", "switch.switch.max_stalled_steps=5")
TIRED = ("mentor=tired", "switch=tired", "switch.switch.switch.switch.max_stalled_steps=5")


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "train.csv").open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


def steps(folder: Path) -> list[SessionStep]:
    """The steps of a session, without what the timing decides."""
    kept = read_session(folder).steps()
    return [dataclasses.replace(step, time=0.0, policy_version=None) for step in kept]


Start = Callable[..., "subprocess.Popen[str]"]


def recorded(where: Path, starter: Start, *overrides: str) -> Path:
    process = starter(where, "haim", *SHORT, *overrides)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return next((where / "runs" / "smoke").iterdir())


@pytest.fixture(scope="module")
def tired(tmp_path_factory: pytest.TempPathFactory, starter: Start) -> Path:
    return recorded(tmp_path_factory.mktemp("tired"), starter, *TIRED)


def test_a_live_session_gives_its_learning_curve_back(
    tired: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    """Whatever the timing: policies reached the driving at other steps, and batches were late."""
    first = rows(tired)
    assert [int(row["frames"]) for row in first] == [50, 100]
    assert int(first[-1]["mentor_steps_total"]) > 0 and float(first[-1]["loss_preference"]) > 0.0
    # No checkpoint cut an episode short.
    assert len(read_session(tired).episodes[0].steps) == 40
    outcome = command("haim", *SHORT, "mentor=replay", f"mentor.session={tired}")
    assert outcome.code == 0, outcome.err
    again = next((tmp_path / "runs" / "smoke").iterdir())
    assert rows(again) == first
    assert steps(again) == steps(tired) and len(steps(again)) == 100


def test_the_policy_of_a_run_teaches_another_one(
    tired: Path, tmp_path: Path, command: Callable[..., Any]
) -> None:
    outcome = command(
        "haim", *SHORT, "total_frames=50", "mentor=policy", f"mentor.checkpoint={tired}",
        "switch=always",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    folder = next((tmp_path / "runs" / "smoke").iterdir())
    assert int(rows(folder)[-1]["mentor_steps_total"]) == 50
    assert [step.intervention for step in steps(folder)] == [True] * 50


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_ctrl_c_leaves_a_checkpoint_and_no_process(tmp_path: Path, starter: Start) -> None:
    endless = ("total_frames=100000", "collector.pace=50", "train.checkpoint_every=100000")
    process = starter(tmp_path, "haim", *SHORT, *SHIELD, *endless)
    try:
        deadline = time.monotonic() + 240
        while not list(tmp_path.glob("runs/smoke/*/train.csv")):
            assert process.poll() is None and time.monotonic() < deadline, process.communicate()
            time.sleep(0.1)
        children = descendants(process.pid)
        assert children  # at least the one that drives
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=240)
    finally:
        process.kill()
    assert process.returncode == 130, err
    assert "stopping after this batch" in err and "Traceback" not in err
    deadline = time.monotonic() + 60
    while running := [pid for pid in children if alive(pid)]:
        assert time.monotonic() < deadline, running
        time.sleep(0.1)

    folder = next((tmp_path / "runs" / "smoke").iterdir())
    said = next(line for line in out.splitlines() if line.startswith("saved; go on with"))
    assert said.endswith(f"recipes/haim.py resume={folder}")
    saved = torch.load(folder / "checkpoints" / "last.pt", weights_only=True)["frames"]
    assert saved >= 50
    before = (folder / "session.jsonl").read_bytes()
    assert len(read_session(folder)) >= saved

    total = saved + 20
    resumed = starter(tmp_path, "haim", f"resume={folder}", f"total_frames={total}")
    out, err = resumed.communicate(timeout=300)
    assert resumed.returncode == 0, err
    assert int(rows(folder)[-1]["frames"]) == total and (folder / "metrics.json").exists()
    # What was driven before stays as it was; this part has a file of its own.
    assert (folder / "session.jsonl").read_bytes() == before
    assert len(read_session(folder / "session_2.jsonl")) >= 20
    assert "step time p50" in out  # a pace was held


def descendants(pid: int) -> list[int]:
    """Processes that were started by a process, or by those."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text().split()):
            found += [child, *descendants(child)]
    return found


def alive(pid: int) -> bool:
    """Whether a process runs; one that nobody has asked about since it ended does not."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (OSError, IndexError):
        return False
