"""Tables, metrics.json, progress line and the helpers of commands."""

from __future__ import annotations

import io
import json
import math
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from haim_torchrl.evaluation.checkpoint import CheckpointError, save_checkpoint
from haim_torchrl.evaluation.command import InterruptFlag, run_folder
from haim_torchrl.evaluation.metrics import EpisodeRecord, summarise
from haim_torchrl.evaluation.progress import ProgressLine, clock
from haim_torchrl.evaluation.schedule import Schedule
from haim_torchrl.evaluation.schema import TrainConfig
from haim_torchrl.evaluation.statistics import Estimate
from haim_torchrl.evaluation.tables import (
    cell,
    main_table,
    print_tables,
    split_table,
    write_metrics,
)


@pytest.mark.parametrize(
    ("estimate", "text"),
    [
        (Estimate(0.5, 0.25, 0.75, 4), "0.50 [0.25, 0.75]"),
        (Estimate(0.5, math.nan, math.nan, 1), "0.50"),
        (Estimate(math.nan, 0.0, 1.0, 0), "-"),
        (None, "-"),
    ],
)
def test_cells(estimate: Estimate | None, text: str) -> None:
    assert cell(estimate) == text


def test_tables_name_drivers_metrics_and_blocks() -> None:
    records = [
        EpisodeRecord(outcome="success", steps=10, blocks=("curve",), obstacles=0, reward=5.0),
        EpisodeRecord(outcome="crash", steps=10, blocks=("fork",), obstacles=1, violations=1.0),
    ]
    stream = io.StringIO()
    rows = {"policy": summarise(records), "mentor": summarise(records[:1])}
    print_tables(
        main_table(rows, "title", {"policy": {"training data usage": "30000"}}),
        split_table(rows),
        stream=stream,
    )
    text = stream.getvalue()
    for part in ("title", "policy", "mentor", "30000", "0.50 [", "curve (1)", "fork (1)",
                 "with obstacles (1)", "disturbance rate"):  # fmt: skip
        assert part in text, part


def test_metrics_are_json_and_never_overwritten(tmp_path: Path) -> None:
    path = write_metrics(tmp_path / "a" / "metrics.json", {"x": [math.nan, 1.0], "y": math.inf})
    assert json.loads(path.read_text()) == {"x": [None, 1.0], "y": None}
    with pytest.raises(FileExistsError, match="never overwritten"):
        write_metrics(path, {})
    assert json.loads(path.read_text())["x"] == [None, 1.0]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_without_a_terminal_is_plain_lines() -> None:
    stream = io.StringIO()
    with ProgressLine(4, every=1e9, stream=stream) as line:
        line.update(1, takeover_rate=0.5)
        line.update(4, takeover_rate=0.25, success=math.nan)
    assert stream.getvalue().startswith("4/4 steps") and "\r" not in stream.getvalue()
    assert "takeover rate 0.25  success -" in stream.getvalue()
    assert stream.getvalue().count("\n") == 1


def test_progress_on_a_terminal_rewrites_its_line() -> None:
    stream = Terminal()
    with ProgressLine(2, stream=stream) as line:
        line.update(2)
        line.note("half way")
    assert stream.getvalue().startswith("\r2/2 steps")
    assert "half way\n" in stream.getvalue()


def test_a_resumed_run_counts_only_its_own_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr("haim_torchrl.evaluation.progress.time.monotonic", lambda: now[0])
    line = ProgressLine(300, start=100, enabled=False)
    now[0] = 110.0
    assert line.text(200, {}) == "200/300 steps  10.0/s  0:10 left"


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0:00"), (59.9, "0:59"), (3600, "1:00:00"), (math.inf, "-:--")]
)
def test_clock(seconds: float, text: str) -> None:
    assert clock(seconds) == text


def test_first_interrupt_is_a_wish_the_second_an_order(capsys: pytest.CaptureFixture[str]) -> None:
    before = signal.getsignal(signal.SIGINT)
    with InterruptFlag() as interrupt:
        assert not interrupt
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupt
        assert "stopping after this batch" in capsys.readouterr().err
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            signal.pause()
    assert signal.getsignal(signal.SIGINT) is before


def test_run_folders_never_meet(tmp_path: Path) -> None:
    first = Path(run_folder("a", root=str(tmp_path)))
    first.mkdir(parents=True)
    second = Path(run_folder("a", root=str(tmp_path)))
    assert first != second and second.parent == first.parent == tmp_path / "a"


def test_a_resumed_run_keeps_its_folder(tmp_path: Path) -> None:
    path = save_checkpoint(tmp_path / "checkpoints" / "last.pt", {})
    for given in (tmp_path, path.parent, path):
        assert run_folder("a", str(given)) == str(tmp_path)
    with pytest.raises(CheckpointError, match="does not exist"):
        run_folder("a", str(tmp_path / "nowhere"))
    assert not (tmp_path / "nowhere").exists()
    lost = save_checkpoint(tmp_path / "lost.pt", {})
    with pytest.raises(CheckpointError, match="outside a run's checkpoints/"):
        run_folder("a", str(lost))


def settings(**fields: float) -> Any:
    return OmegaConf.structured(TrainConfig(**fields))  # type: ignore[arg-type]


def test_updates_follow_the_ratio_and_keep_the_rest() -> None:
    schedule = Schedule(settings(updates_per_step=0.3, learning_starts=10), 100)
    due = [schedule.advance(10) for _ in range(10)]
    assert due == [0, 3, 3, 3, 3, 3, 3, 3, 3, 3]
    odd = Schedule(settings(updates_per_step=0.25, learning_starts=3), 100)
    assert [odd.advance(7) for _ in range(4)] == [1, 1, 2, 2]  # 1, 2.75, 4.5, 6.25 in all


def test_what_is_due() -> None:
    schedule = Schedule(settings(log_every=25, validate_every=0, checkpoint_every=40), 60)
    logs, saves = [], []
    for _ in range(6):
        schedule.advance(10)
        logs.append(schedule.due("log"))
        saves.append(schedule.due("checkpoint"))
        assert not schedule.due("validate")
    assert logs == [False, False, True, False, True, True]
    assert saves == [False, False, False, True, False, True]
