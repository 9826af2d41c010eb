"""Learning curves of several methods, against environment steps and against mentor steps."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from haim_torchrl.evaluation.curves import smooth
from haim_torchrl.report.methods import Method
from haim_torchrl.report.paper import CurveFigure, figures, known
from haim_torchrl.report.runs import FinishedRun

Array = NDArray[np.float64]
GRID = 60
"""Points of a curve whose seeds were measured at different steps."""


@dataclass(frozen=True)
class Panel:
    """A diagram of a figure.

    Attributes:
        title: What it shows.
        column: Column of the validations; ``takeover_rate`` or ``violations_total`` for the
            course of the training.
        unit: Whether the values lie between 0 and 1.
        signed: Whether they may be negative.
    """

    title: str
    column: str
    unit: bool = False
    signed: bool = False


PANELS = (
    Panel("success, validation", "success", unit=True),
    Panel("return, validation", "return", signed=True),
    Panel("safety violations, validation", "violations"),
    Panel("disturbance rate, validation", "disturbance_rate"),
    Panel("takeover rate, training", "takeover_rate", unit=True),
    Panel("safety violations so far, training", "violations_total"),
)
AXES = {"frames": "environment steps [thousand]", "mentor_steps": "mentor steps [thousand]"}


class Band(NamedTuple):
    """A curve over seeds: steps, mean, lowest and highest, ``[n]`` each."""

    steps: Array
    mean: Array
    low: Array
    high: Array


def series(run: FinishedRun, column: str, axis: str) -> tuple[Array, Array]:
    """A run's curve.

    Args:
        run: The run.
        column: As in :class:`Panel`.
        axis: ``"frames"`` or ``"mentor_steps"``.

    Returns:
        Steps and values, ``[n]`` each, without those that are unknown; n is 0 where the run has
        no such column.
    """
    if column in ("takeover_rate", "violations_total"):
        steps = _array(run.course.get(axis, ()))
        if column == "violations_total":
            values = _array(run.course.get("violations", ()))
        else:
            mentor, frames = (_array(run.course.get(n, ())) for n in ("mentor_steps", "frames"))
            driven = np.diff(frames, prepend=0.0)
            moved = driven > 0.0  # learning from a fixed data set does not drive on
            rates = np.diff(mentor, prepend=0.0)[moved] / driven[moved]
            steps, values = steps[moved], smooth(rates, max(len(rates) // 10, 1))
    else:
        steps = _array(run.validation.get(axis, ()))
        values = _array(run.validation.get(column, ()))
    known = np.isfinite(values) & np.isfinite(steps)
    return steps[known], values[known]


def _array(values: ArrayLike) -> Array:
    return np.array(values, dtype=np.float64)


def band(curves: Sequence[tuple[Array, Array]]) -> Band | None:
    """Mean, lowest and highest of several curves where all of them are known.

    Args:
        curves: Steps, not decreasing, and values of each seed.

    Returns:
        At the steps of the curves if they are the same, else interpolated; None where there is
        no step that all have.
    """
    curves = [curve for curve in curves if len(curve[0])]
    if not curves:
        return None
    first = curves[0][0]
    if all(np.array_equal(steps, first) for steps, _ in curves):
        grid, values = first, np.stack([values for _, values in curves])
    else:
        low, high = max(c[0][0] for c in curves), min(c[0][-1] for c in curves)
        if low > high:
            return None
        grid = np.linspace(low, high, GRID)
        values = np.stack([np.interp(grid, *curve) for curve in curves])
    return Band(grid, values.mean(0), values.min(0), values.max(0))


def draw_curves(methods: Mapping[str, Method], title: str, path: str | os.PathLike[str]) -> Path:
    """Draw the learning curves of some methods: mean over seeds, and lowest to highest.

    Args:
        methods: Methods of the figure.
        title: Title.
        path: Image to write.

    Returns:
        The path.
    """
    figure = Figure(figsize=(18, 6), layout="constrained")
    figure.suptitle(f"{title} (mean over seeds, lowest to highest)", fontsize=10)
    grid = figure.subplots(len(AXES), len(PANELS))
    for line, (axis, label) in zip(grid, AXES.items()):
        for axes, panel in zip(line, PANELS):
            _draw(axes, methods, panel, axis)
            axes.set_xlabel(label, fontsize=8)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=8, frameon=False)
    figure.savefig(path, dpi=90)
    return Path(path)


def _draw(axes: Axes, methods: Mapping[str, Method], panel: Panel, axis: str) -> None:
    ends = []
    for place, (name, method) in enumerate(methods.items()):
        found = band([series(run, panel.column, axis) for run in method.runs])
        color = f"C{place % 10}"
        label = f"{known(name).title} (n={method.seeds})"
        if found is None or (axis == "mentor_steps" and found.steps[-1] == 0.0):
            axes.plot([], [], color=color, label=label)  # no mentor: it has no such axis
            continue
        steps = found.steps / 1000.0
        ends.append(float(steps[-1]))
        if steps[0] == steps[-1]:  # learned from a fixed data set: a point at its size
            low, high = found.mean[-1] - found.low[-1], found.high[-1] - found.mean[-1]
            axes.errorbar(
                steps[-1:], found.mean[-1:], [[low], [high]], fmt="s", color=color, label=label
            )
            continue
        axes.plot(steps, found.mean, color=color, lw=1.4, label=label)
        axes.fill_between(steps, found.low, found.high, color=color, alpha=0.15, lw=0)
    axes.set_title(panel.title, fontsize=9, loc="left")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    if panel.unit:
        axes.set_ylim(-0.02, 1.02)
    elif not panel.signed and ends:
        axes.set_ylim(bottom=0.0)
    if ends and max(ends) > 4.0 * min(ends):
        axes.set_xscale("log")  # budgets that differ as those of Table 1 do
    if not ends:
        axes.text(0.5, 0.5, "no data", ha="center", transform=axes.transAxes, color="0.5")


def draw_figures(
    methods: Mapping[str, Method], reference: str, folder: Path
) -> list[tuple[str, Path]]:
    """The paper's figures of learning curves, as far as there are runs for them.

    Args:
        methods: Methods by name.
        reference: Method that stands in each figure beside the others.
        folder: Where the images go.

    Returns:
        Titles and images; methods that no figure of the paper has come in one of their own.
    """
    trained = {name: method for name, method in methods.items() if method.trained}
    groups = list(figures())
    placed = {name for group in groups for name in group.names} | {reference}
    others = tuple(name for name in trained if name not in placed)
    if others or set(trained) == {reference}:
        groups.append(CurveFigure("others", "Other runs", others))
    drawn = []
    for group in groups:
        chosen = [name for name in (reference, *group.names) if name in trained]
        if set(chosen) - {reference} or group.key == "others":
            members = {name: trained[name] for name in chosen}
            path = draw_curves(members, group.title, folder / f"{group.key}.png")
            drawn.append((group.title, path))
    return drawn
