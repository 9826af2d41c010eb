"""The results of several runs side by side: methods with their seeds taken together."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from matplotlib.figure import Figure
from rich.table import Table

from haim_torchrl.evaluation.statistics import Estimate, range_interval
from haim_torchrl.evaluation.tables import cell
from haim_torchrl.report.curves import band, series
from haim_torchrl.report.methods import Method
from haim_torchrl.report.runs import FinishedRun, read_result, result_files
from haim_torchrl.report.statistics import crossed_interval


def read_runs(folder: str | os.PathLike[str]) -> dict[str, Method]:
    """All finished runs below a folder, such as that of a sweep, by method.

    Args:
        folder: Searched with its subfolders. They have the names of the runs' overrides; those
            that not all runs share, without the seed, are the name of the method.

    Returns:
        Methods in the order of their first run.

    Raises:
        RunFileError: If a result cannot be read.
    """
    found = []
    for path in result_files(Path(folder)):
        overrides = str(path.parent.relative_to(folder)).split(",")
        found.append(([o for o in overrides if o != "." and not o.startswith("seed=")], path))
    shared = set.intersection(*(set(overrides) for overrides, _ in found)) if found else set()
    groups: dict[str, list[FinishedRun]] = {}
    for overrides, path in found:
        name = ",".join(o.removeprefix("method=") for o in overrides if o not in shared)
        for run in read_result(path):
            groups.setdefault(name or run.name, []).append(run)
    return {name: Method(name, runs) for name, runs in groups.items()}


class Line(NamedTuple):
    """A line of the comparison."""

    heading: str
    decimals: int
    estimate: Callable[[Method], Estimate]


def _test(measure: str) -> Callable[[Method], Estimate]:
    return lambda method: range_interval(method.scores(measure).figures())


def _training(total: str, scale: float = 1.0) -> Callable[[Method], Estimate]:
    return lambda method: range_interval([scale * run.total(total) for run in method.runs])


def _own_brakes(run: FinishedRun) -> float:
    """Hard brakes in 1000 steps that the agent drove in training."""
    driven = run.total("frames") - run.total("mentor_steps")
    return 1000.0 * run.total("hard_brakes") / driven if driven else math.nan


LINES = (
    Line("success", 2, lambda method: crossed_interval(method.scores("success"))),
    Line("collisions per test episode", 2, _test("violations")),
    Line("off road", 2, _test("out_of_road")),
    Line("time-out", 2, _test("timeout")),
    Line("speed [m/s]", 1, _test("speed")),
    Line("disturbance rate", 4, _test("disturbance_rate")),
    Line(
        "hard brakes per 1000 own steps in training",
        1,
        lambda method: range_interval([_own_brakes(run) for run in method.runs]),
    ),
    Line("collisions in training", 1, _training("violations")),
    Line("mentor-driven steps", 0, _training("mentor_steps")),
    Line("takeovers", 0, _training("takeovers")),
    Line("takeover rate, first fifth", 2, _training("takeover_rate_first_fifth")),
    Line("takeover rate, last fifth", 2, _training("takeover_rate_last_fifth")),
    Line("minutes", 0, _training("seconds", 1.0 / 60.0)),
)
"""Success has an interval over seeds and scenarios, the others their lowest and highest run."""


def comparison_table(methods: Mapping[str, Method]) -> Table:
    """The comparison for the terminal: a column for each method."""
    table = Table(
        title="means over seeds; success with its 95 % interval, the others lowest to highest",
        title_justify="left",
    )
    table.add_column("")
    for name in methods:
        table.add_column(name, justify="right")
    table.add_row("runs", *(str(group.seeds) for group in methods.values()))
    for heading, decimals, estimate in LINES:
        table.add_row(heading, *(cell(estimate(group), decimals) for group in methods.values()))
    return table


def write_comparison(methods: Mapping[str, Method], folder: str | os.PathLike[str]) -> list[Path]:
    """Write ``comparison.md``, methods side by side, and ``comparison.csv``, a row for each run.

    Returns:
        Both paths.
    """
    markdown, table = Path(folder) / "comparison.md", Path(folder) / "comparison.csv"
    lines = [
        f"| | {' | '.join(methods)} |",
        "|" + "---|" * (len(methods) + 1),
        f"| runs | {' | '.join(str(group.seeds) for group in methods.values())} |",
    ]
    for heading, decimals, estimate in LINES:
        cells = [cell(estimate(group), decimals) for group in methods.values()]
        lines.append(f"| {heading} | {' | '.join(cells)} |")
    markdown.write_text("\n".join(lines) + "\n")
    with table.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["method", "seed", *(line.heading for line in LINES)])
        for name, group in methods.items():
            for run in group.runs:
                values = [line.estimate(Method(name, [run])).value for line in LINES]
                writer.writerow([name, run.seed, *values])
    return [markdown, table]


def draw_comparison(methods: Mapping[str, Method], path: str | os.PathLike[str]) -> Path:
    """Draw test success with its interval, and the course of the training of each method.

    Returns:
        The path.
    """
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    success, validation, takeovers = figure.subplots(1, 3)
    for place, (name, group) in enumerate(methods.items()):
        estimate = LINES[0].estimate(group)
        color = f"C{place % 10}"
        success.plot([estimate.low, estimate.high], [place, place], color=color, lw=2)
        success.plot(estimate.value, place, "o", color=color)
        for figure_of_seed in group.scores("success").figures():
            success.plot(figure_of_seed, place, "|", color=color, ms=12)
        for axes, column in ((validation, "success"), (takeovers, "takeover_rate")):
            curve = band([series(run, column, "frames") for run in group.runs])
            if curve is not None:
                steps = curve.steps / 1000.0
                axes.plot(steps, curve.mean, color=color, lw=1.4, label=name)
                axes.fill_between(steps, curve.low, curve.high, color=color, alpha=0.12, lw=0)
    success.set_yticks(range(len(methods)), list(methods))
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
