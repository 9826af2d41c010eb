"""What a run writes down."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.evaluation.training_log import CsvTable, TrainingLog, fifths


def batch(flags: list[int], done: list[int], success: list[int] | None = None) -> TensorDict:
    def column(values: list[int]) -> torch.Tensor:
        return torch.tensor(values, dtype=torch.bool).unsqueeze(-1)

    size = [len(flags)]
    before = [0, *flags[:-1]]
    return TensorDict(
        {
            "intervention": column(flags),
            "takeover_start": column([f and not b for f, b in zip(flags, before)]),
            "next": TensorDict(
                {
                    "done": column(done),
                    "success": column(success or [0] * len(flags)),
                    "takeover_cost": torch.full((len(flags), 1), 0.5),
                },
                size,
            ),
        },
        size,
    )


class Recorder:
    def __init__(self) -> None:
        self.seen: list[tuple[str, float, int | None]] = []

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        self.seen.append((name, value, step))


def test_a_row_counts_since_the_last(tmp_path: Path) -> None:
    recorder = Recorder()
    log = TrainingLog(tmp_path, recorder)
    log.add_batch(batch([1, 1, 0, 1], [0, 0, 0, 1], [0, 0, 0, 1]))
    assert log.takeover_rate == 0.75
    log.add_losses(TensorDict({"loss_actor": torch.tensor(1.0)}, []))
    log.add_losses(TensorDict({"loss_actor": torch.tensor(3.0)}, []))
    first = log.write_row()
    assert first["frames"] == 4 and first["takeover_rate"] == 0.75
    assert first["takeovers"] == 2 and first["takeover_cost"] == 2.0
    assert first["loss_actor"] == 2.0 and first["success_recent"] == 1.0
    log.add_batch(batch([0, 0], [0, 0]))
    second = log.write_row()
    assert second["takeover_rate"] == 0.0 and second["mentor_steps_total"] == 3
    assert "loss_actor" not in second
    rows = CsvTable(tmp_path / "train.csv").read()
    assert [row["frames"] for row in rows] == ["4", "6"]
    assert rows[1]["loss_actor"] == ""
    assert ("train/takeover_rate", 0.75, 4) in recorder.seen


def test_a_late_column_joins_the_table(tmp_path: Path) -> None:
    table = CsvTable(tmp_path / "t.csv")
    table.append({"a": 1})
    table.append({"a": 2, "b": 3})
    CsvTable(tmp_path / "t.csv").append({"b": 4})
    assert table.read() == [{"a": "1", "b": ""}, {"a": "2", "b": "3"}, {"a": "", "b": "4"}]


def test_resuming_drops_what_is_driven_again(tmp_path: Path) -> None:
    log = TrainingLog(tmp_path)
    log.add_batch(batch([1, 0], [0, 1]))
    log.write_row()
    state = log.state_dict()
    log.add_batch(batch([1, 1], [0, 1]))
    log.write_row()
    log.write_validation({"success": 1.0})

    resumed = TrainingLog(tmp_path)
    resumed.load_state_dict(state)
    assert resumed.totals["frames"] == 2 and resumed.totals["mentor_steps"] == 1
    assert len(CsvTable(tmp_path / "train.csv").read()) == 1
    assert len(CsvTable(tmp_path / "episodes.csv").read()) == 1
    assert CsvTable(tmp_path / "validation.csv").read() == []


def test_every_environment_has_its_own_episodes(tmp_path: Path) -> None:
    log = TrainingLog(tmp_path)
    both = torch.stack([batch([1, 1], [0, 1]), batch([0, 0], [0, 0])])
    finished = log.add_batch(both)
    assert [record.steps for record in finished] == [2]
    assert finished[0].mentor_steps == 2


def test_fifths_by_hand() -> None:
    # 10 steps a row, mentor steps 8, 4, 2, 1, 0: first fifth 0.8, last fifth 0.
    assert fifths([10, 20, 30, 40, 50], [8, 12, 14, 15, 15]) == (0.8, 0.0)
    # One row of 100 steps: the rate is the same everywhere.
    assert fifths([100.0], [50.0]) == pytest.approx((0.5, 0.5))
    assert all(math.isnan(rate) for rate in fifths([], []))
