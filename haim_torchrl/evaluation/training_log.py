"""What a training run writes down while it runs."""

from __future__ import annotations

import csv
import math
import os
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.evaluation.metrics import EpisodeMeter, EpisodeRecord, steps_of
from haim_torchrl.evaluation.real_time import StepTimes


class ScalarLogger(Protocol):
    """The part of a ``torchrl.record`` logger that is used here."""

    def log_scalar(self, name: str, value: float, step: int | None = None) -> None:
        """Log one number."""
        ...


class CsvTable:
    """A CSV file that grows by rows; a new column is added to the earlier rows as empty.

    Args:
        path: File; an existing one is continued.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._columns: list[str] = []
        if self.path.exists():
            with self.path.open(newline="") as stream:
                self._columns = next(csv.reader(stream), [])

    def read(self) -> list[dict[str, str]]:
        """All rows so far."""
        if not self.path.exists():
            return []
        with self.path.open(newline="") as stream:
            return list(csv.DictReader(stream))

    def append(self, row: Mapping[str, Any]) -> None:
        """Add a row; it is on disk when this returns."""
        fresh = [key for key in row if key not in self._columns]
        if fresh:
            self._columns += fresh
            self._rewrite(self.read())
        with self.path.open("a", newline="") as stream:
            csv.DictWriter(stream, self._columns, restval="").writerow(dict(row))

    def keep(self, column: str, at_most: float) -> None:
        """Drop the rows in which ``column`` exceeds ``at_most``; one without a value is kept."""
        rows = self.read()
        kept = [row for row in rows if float(row.get(column) or "-inf") <= at_most]
        if len(kept) < len(rows):
            self._rewrite(kept)

    def _rewrite(self, rows: list[dict[str, str]]) -> None:
        partial = self.path.with_name(self.path.name + ".partial")
        with partial.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, self._columns, restval="")
            writer.writeheader()
            writer.writerows(rows)
        os.replace(partial, self.path)


class TrainingLog:
    """Counts what happens in training and writes it to CSV files and a logger.

    ``train.csv`` has a row per interval, ``episodes.csv`` one per finished training episode,
    ``validation.csv`` one per validation.

    Args:
        folder: Where the files go.
        logger: A ``torchrl.record`` logger such as TensorBoard or W&B, or None.
        window: Number of last episodes behind the success shown.
        pace: Steps per second that the run is to keep; None for none.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        logger: ScalarLogger | None = None,
        window: int = 20,
        pace: float | None = None,
    ) -> None:
        self.folder = Path(folder)
        self._logger = logger
        self._train = CsvTable(self.folder / "train.csv")
        self._episodes = CsvTable(self.folder / "episodes.csv")
        self._validation = CsvTable(self.folder / "validation.csv")
        self.step_times = StepTimes(pace)
        self._meters: list[EpisodeMeter] = []
        self._recent: deque[bool] = deque(maxlen=window)
        self.totals: dict[str, float] = dict.fromkeys(
            (
                "frames",
                "mentor_steps",
                "takeovers",
                "violations",
                "takeover_cost",
                "disturbance_cost",
                "hard_brakes",
                "episodes",
                "successes",
                "updates",
                "seconds",
            ),
            0.0,
        )
        self._marked = dict(self.totals)
        self._clock = time.monotonic()
        self._losses: dict[str, Tensor] = {}
        self._loss_count = 0

    @property
    def success(self) -> float:
        """Share of the last training episodes that arrived, with the mentor's help."""
        return sum(self._recent) / len(self._recent) if self._recent else math.nan

    @property
    def takeover_rate(self) -> float:
        """Share of mentor-driven steps since the last row."""
        frames = self.totals["frames"] - self._marked["frames"]
        steps = self.totals["mentor_steps"] - self._marked["mentor_steps"]
        return steps / frames if frames else math.nan

    def add_batch(self, batch: TensorDictBase) -> list[EpisodeRecord]:
        """Count a collected batch ``[T]`` or ``[B, T]``.

        Returns:
            The episodes that ended in it.
        """
        self.step_times.add(batch)
        rows = steps_of(batch)
        while len(self._meters) < len(rows):
            self._meters.append(EpisodeMeter())
        takeover_cost = batch.get(("next", "takeover_cost"), None)
        if takeover_cost is not None:
            self.totals["takeover_cost"] += float(takeover_cost.sum())
        finished: list[EpisodeRecord] = []
        for meter, steps in zip(self._meters, rows):
            for step in steps:
                self.totals["frames"] += 1
                self.totals["mentor_steps"] += step.get("intervention", 0.0)
                self.totals["takeovers"] += step.get("takeover_start", 0.0)
                self.totals["violations"] += step.get("cost", 0.0)
                self.totals["hard_brakes"] += step.get("disturbance", 0.0)
                self.totals["disturbance_cost"] += step.get("disturbance_cost", 0.0)
                record = meter.add(step)
                if record is not None:
                    finished.append(record)
        for record in finished:
            self._recent.append(record.success)
            self.totals["episodes"] += 1
            self.totals["successes"] += record.success
            row = {"frames": int(self.totals["frames"]), **record.as_dict()}
            row["takeovers"] = len(record.takeover_lengths)
            del row["takeover_lengths"], row["blocks"], row["scenario"], row["obstacles"]
            self._episodes.append(row)
        return finished

    def add_demonstrations(self, data: TensorDictBase) -> None:
        """Count steps ``[N]`` of a dataset, or that the mentor drove alone, and who drove them."""
        self.totals["frames"] += len(data)
        self.totals["mentor_steps"] += int(data["intervention"].sum())
        cost = data.get(("next", "cost"), None)
        if cost is not None:
            self.totals["violations"] += float(cost.sum())

    def restart_episodes(self) -> None:
        """Forget unfinished episodes, because the environments were reset."""
        for meter in self._meters:
            meter.start()

    def add_losses(self, losses: TensorDictBase) -> None:
        """Add the losses and diagnostics of one update to the running means."""
        self.totals["updates"] += 1
        self._loss_count += 1
        for key, value in losses.items():
            if isinstance(value, Tensor) and value.numel() == 1:
                number = value.detach().reshape(()).float()
                former = self._losses.get(key)
                self._losses[key] = number if former is None else former + number

    def write_row(self, **extra: float) -> dict[str, float]:
        """Write what happened since the last row to ``train.csv`` and the logger.

        Args:
            **extra: Further columns.

        Returns:
            The row. Keys: ``frames``, rates since the last row, ``*_total`` since the start, and
            the mean of each loss and diagnostic.
        """
        now = time.monotonic()
        self.totals["seconds"] += now - self._clock
        self._clock = now
        gained = {key: self.totals[key] - self._marked[key] for key in self.totals}
        frames = max(gained["frames"], 1.0)
        row: dict[str, float] = {
            "frames": int(self.totals["frames"]),
            "updates": int(self.totals["updates"]),
            "takeover_rate": gained["mentor_steps"] / frames,
            "disturbance_rate": gained["hard_brakes"] / frames,
            "takeovers": gained["takeovers"],
            "takeover_cost": gained["takeover_cost"],
            "disturbance_cost": gained["disturbance_cost"],
            "violations": gained["violations"],
            "success_recent": self.success,
            "mentor_steps_total": int(self.totals["mentor_steps"]),
            "violations_total": int(self.totals["violations"]),
            "episodes_total": int(self.totals["episodes"]),
            "seconds": self.totals["seconds"],
        }
        if self._loss_count:
            names = sorted(self._losses)
            sums = torch.stack([self._losses[name] for name in names])
            means = (sums / self._loss_count).tolist()
            row.update(zip(names, means))
        row.update(extra)
        self._train.append(row)
        self._send("train", row)
        self._marked = dict(self.totals)
        self._losses, self._loss_count = {}, 0
        return row

    def write_validation(self, figures: Mapping[str, float]) -> None:
        """Write the figures of a validation to ``validation.csv`` and the logger."""
        row = {
            "frames": int(self.totals["frames"]),
            "updates": int(self.totals["updates"]),
            **figures,
        }
        self._validation.append(row)
        self._send("validation", row)

    def _send(self, group: str, row: Mapping[str, float]) -> None:
        if self._logger is None:
            return
        step = int(row["frames"])
        for key, value in row.items():
            if key != "frames" and math.isfinite(value):
                self._logger.log_scalar(f"{group}/{key}", float(value), step=step)

    def takeover_rates(self) -> tuple[float, float]:
        """Takeover rate in the first and in the last fifth of the run so far.

        Computed from ``train.csv``, hence as exact as its rows are fine.
        """
        rows = self._train.read()
        return fifths(
            [float(row["frames"]) for row in rows],
            [float(row["mentor_steps_total"]) for row in rows],
        )

    def state_dict(self) -> dict[str, Any]:
        """Counters for a checkpoint; the CSV files hold the rest."""
        return {
            "totals": dict(self.totals),
            "marked": dict(self._marked),
            "recent": list(self._recent),
            "losses": dict(self._losses),
            "loss_count": self._loss_count,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a checkpoint: rows written after it are dropped, they are driven again."""
        self.totals = dict(state["totals"])
        self._marked = dict(state["marked"])
        self._recent.clear()
        self._recent.extend(state["recent"])
        self._losses = dict(state["losses"])
        self._loss_count = state["loss_count"]
        for table in (self._train, self._episodes, self._validation):
            table.keep("frames", self.totals["frames"])
            table.keep("updates", self.totals["updates"])  # alone where frames stand still


def fifths(frames: list[float], cumulative: list[float]) -> tuple[float, float]:
    """Rates in the first and the last fifth of a run, from running totals.

    Args:
        frames: Steps driven at each row, increasing.
        cumulative: Running total of some count at each row.

    Returns:
        Count per step over the first fifth, and over the last; NaN without rows. Totals between
        rows are interpolated linearly.
    """
    if not frames:
        return math.nan, math.nan

    def total_at(frame: float) -> float:
        before_frame, before_total = 0.0, 0.0
        for at, total in zip(frames, cumulative):
            if at >= frame:
                share = (frame - before_frame) / (at - before_frame) if at > before_frame else 1.0
                return before_total + share * (total - before_total)
            before_frame, before_total = at, total
        return before_total

    end = frames[-1]
    fifth = end / 5.0
    return total_at(fifth) / fifth, (cumulative[-1] - total_at(end - fifth)) / fifth
