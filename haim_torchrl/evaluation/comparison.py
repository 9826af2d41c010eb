"""The results of several runs side by side: methods with their seeds taken together."""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from haim_torchrl.evaluation.curves import smooth
from haim_torchrl.evaluation.statistics import Estimate, nested_interval, range_interval
from haim_torchrl.evaluation.tables import cell
from haim_torchrl.evaluation.training_log import CsvTable

RESULT_FILE = "metrics.json"
"""What a run writes last: a folder without it holds no finished run."""


@dataclass(frozen=True)
class FinishedRun:
    """A run that came to its end.

    Attributes:
        method: The overrides that tell it from the others, without the seed.
        folder: Its folder.
        metrics: Contents of its ``metrics.json``.
    """

    method: str
    folder: Path
    metrics: Mapping[str, Any]

    def episodes(self, name: str) -> list[float]:
        """A figure of each test episode; ``success`` as 0 or 1."""
        rows = self.metrics["episodes"]
        if name == "success":
            return [float(row["outcome"] == "success") for row in rows]
        return [float(row[name]) for row in rows]

    def training(self, name: str) -> float:
        """A total of the training; NaN where it was not counted."""
        value = self.metrics["training"].get(name)
        return math.nan if value is None else float(value)

    def test(self, name: str) -> float:
        """A figure over all test episodes; NaN where there is none."""
        value = self.metrics["test"]["overall"][name]["value"]
        return math.nan if value is None else float(value)


def read_runs(folder: str | os.PathLike[str]) -> list[FinishedRun]:
    """All finished runs below a folder, such as that of a sweep.

    Args:
        folder: Searched with its subfolders. They have the names of the runs' overrides; those
            that not all runs share, without the seed, are the name of the method.
    """
    found = []
    for path in sorted(Path(folder).rglob(RESULT_FILE)):
        overrides = str(path.parent.relative_to(folder)).split(",")
        found.append(([o for o in overrides if o != "." and not o.startswith("seed=")], path))
    shared = set.intersection(*(set(overrides) for overrides, _ in found)) if found else set()
    runs = []
    for overrides, path in found:
        metrics = json.loads(path.read_text())
        name = ",".join(o.removeprefix("method=") for o in overrides if o not in shared)
        runs.append(FinishedRun(name or metrics["name"], path.parent, metrics))
    return runs


def by_method(runs: Sequence[FinishedRun]) -> dict[str, list[FinishedRun]]:
    """The runs of each method, methods in the order of their first run."""
    groups: dict[str, list[FinishedRun]] = {}
    for run in runs:
        groups.setdefault(run.method, []).append(run)
    return groups


class Line(NamedTuple):
    """A line of the comparison."""

    heading: str
    decimals: int
    estimate: Callable[[Sequence[FinishedRun]], Estimate]


def _per_run(figure: Callable[[FinishedRun], float]) -> Callable[[Sequence[FinishedRun]], Estimate]:
    return lambda runs: range_interval([figure(run) for run in runs])


def _own_brakes(run: FinishedRun) -> float:
    """Hard brakes in 1000 steps that the agent drove in training."""
    driven = run.training("frames") - run.training("mentor_steps")
    return 1000.0 * run.training("hard_brakes") / driven if driven else math.nan


LINES = (
    Line("success", 2, lambda runs: nested_interval([run.episodes("success") for run in runs])),
    Line("collisions per test episode", 2, _per_run(lambda run: run.test("violations"))),
    Line("off road", 2, _per_run(lambda run: run.test("out_of_road"))),
    Line("time-out", 2, _per_run(lambda run: run.test("timeout"))),
    Line("speed [m/s]", 1, _per_run(lambda run: run.test("speed"))),
    Line("disturbance rate", 4, _per_run(lambda run: run.test("disturbance_rate"))),
    Line("hard brakes per 1000 own steps in training", 1, _per_run(_own_brakes)),
    Line("collisions in training", 1, _per_run(lambda run: run.training("violations"))),
    Line("mentor-driven steps", 0, _per_run(lambda run: run.training("mentor_steps"))),
    Line("takeovers", 0, _per_run(lambda run: run.training("takeovers"))),
    Line(
        "takeover rate, first fifth",
        2,
        _per_run(lambda run: run.training("takeover_rate_first_fifth")),
    ),
    Line(
        "takeover rate, last fifth",
        2,
        _per_run(lambda run: run.training("takeover_rate_last_fifth")),
    ),
    Line("minutes", 0, _per_run(lambda run: run.training("seconds") / 60.0)),
)
"""Success has an interval over seeds and episodes, the others their lowest and highest run."""


def comparison_table(runs: Sequence[FinishedRun]) -> Table:
    """The comparison for the terminal: a column for each method."""
    groups = by_method(runs)
    table = Table(
        title="means over seeds; success with its 95 % interval, the others lowest to highest",
        title_justify="left",
    )
    table.add_column("")
    for name in groups:
        table.add_column(name, justify="right")
    table.add_row("runs", *(str(len(group)) for group in groups.values()))
    for heading, decimals, estimate in LINES:
        table.add_row(heading, *(cell(estimate(group), decimals) for group in groups.values()))
    return table


def write_comparison(runs: Sequence[FinishedRun], folder: str | os.PathLike[str]) -> list[Path]:
    """Write ``comparison.md``, methods side by side, and ``comparison.csv``, a row for each run.

    Returns:
        Both paths.
    """
    markdown, table = Path(folder) / "comparison.md", Path(folder) / "comparison.csv"
    groups = by_method(runs)
    lines = [
        f"| | {' | '.join(groups)} |",
        "|" + "---|" * (len(groups) + 1),
        f"| runs | {' | '.join(str(len(group)) for group in groups.values())} |",
    ]
    for heading, decimals, estimate in LINES:
        cells = [cell(estimate(group), decimals) for group in groups.values()]
        lines.append(f"| {heading} | {' | '.join(cells)} |")
    markdown.write_text("\n".join(lines) + "\n")
    with table.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["method", "seed", *(line.heading for line in LINES)])
        for run in runs:
            values = [line.estimate([run]).value for line in LINES]
            writer.writerow([run.method, run.metrics["seed"], *values])
    return [markdown, table]


def _curve(runs: Sequence[FinishedRun], table: str, column: str) -> tuple[Any, Any, Any, Any]:
    """Steps, mean, lowest and highest over runs, at the steps that the shortest run has."""
    series = []
    for run in runs:
        rows = CsvTable(run.folder / table).read()
        series.append([(float(r["frames"]), float(r.get(column) or math.nan)) for r in rows])
    length = min(map(len, series))
    values = np.array([[value for _, value in rows[:length]] for rows in series])
    if table == "train.csv":
        values = np.stack([smooth(row, max(length // 10, 1)) for row in values])
    frames = np.array([frame for frame, _ in series[0][:length]])
    return frames, values.mean(0), values.min(0), values.max(0)


def draw_comparison(runs: Sequence[FinishedRun], path: str | os.PathLike[str]) -> Path:
    """Draw test success with its interval, and the course of the training of each method.

    Returns:
        The path.
    """
    groups = by_method(runs)
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    success, validation, takeovers = figure.subplots(1, 3)
    for place, (name, group) in enumerate(groups.items()):
        estimate = LINES[0].estimate(group)
        color = f"C{place % 10}"
        success.plot([estimate.low, estimate.high], [place, place], color=color, lw=2)
        success.plot(estimate.value, place, "o", color=color)
        for run in group:
            success.plot(run.test("success"), place, "|", color=color, ms=12)
        for axes, table, column in (
            (validation, "validation.csv", "success"),
            (takeovers, "train.csv", "takeover_rate"),
        ):
            if all((run.folder / table).exists() for run in group):
                frames, mean, low, high = _curve(group, table, column)
                axes.plot(frames / 1000.0, mean, color=color, lw=1.4, label=name)
                axes.fill_between(frames / 1000.0, low, high, color=color, alpha=0.12, lw=0)
    success.set_yticks(range(len(groups)), list(groups))
    success.invert_yaxis()
    success.set_xlim(-0.02, 1.02)
    success.set_title("success in the test, no mentor", fontsize=9, loc="left")
    validation.set_title("success on validation (mean, lowest to highest)", fontsize=9, loc="left")
    takeovers.set_title("takeover rate", fontsize=9, loc="left")
    for axes in (validation, takeovers):
        axes.set_xlabel("environment steps [thousand]", fontsize=8)
        axes.set_ylim(-0.02, 1.02)
    takeovers.legend(fontsize=7, frameon=False)
    for axes in (success, validation, takeovers):
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    return Path(path)
