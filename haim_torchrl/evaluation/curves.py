"""Learning curves of one run from the CSV files that it wrote."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from haim_torchrl.evaluation.training_log import CsvTable


@dataclass(frozen=True)
class Panel:
    """One diagram of the figure.

    Attributes:
        title: What it shows.
        table: ``"train"`` or ``"validation"``.
        columns: Columns drawn, each if it is there.
        band: Columns of the lower and upper end of an interval around the first column.
    """

    title: str
    table: str
    columns: tuple[str, ...]
    band: tuple[str, str] | None = None


PANELS = (
    Panel(
        "success on validation, no mentor",
        "validation",
        ("success",),
        ("success_low", "success_high"),
    ),
    Panel("takeover rate", "train", ("takeover_rate",)),
    Panel("disturbance rate", "train", ("disturbance_rate",)),
    Panel("safety violations so far", "train", ("violations_total",)),
    Panel("|Q|", "train", ("proxy_q_abs_mean", "explicit_abs_mean", "implicit_abs_mean")),
    Panel("entropy [nat]", "train", ("entropy",)),
)


def _column(rows: Sequence[dict[str, str]], name: str) -> NDArray[np.float64]:
    return np.array([float(row.get(name) or math.nan) for row in rows])


def smooth(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Centred moving mean over ``window`` rows, shorter at both ends; NaN rows are left out.

    Args:
        values: ``[n]``.
        window: Rows in a mean; 1 changes nothing.
    """
    if window <= 1 or len(values) == 0:
        return values
    known = np.isfinite(values)
    kernel = np.ones(min(window, len(values)))
    sums = np.convolve(np.where(known, values, 0.0), kernel, mode="same")
    counts = np.convolve(known.astype(float), kernel, mode="same")
    return np.where(counts > 0, sums / np.maximum(counts, 1.0), np.nan)


def _draw(axes: Axes, panel: Panel, rows: Sequence[dict[str, str]], clock: str) -> None:
    axes.set_title(panel.title, fontsize=9, loc="left")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    if not rows:
        axes.text(0.5, 0.5, "no data", ha="center", transform=axes.transAxes, color="0.5")
        return
    frames = _column(rows, clock) / 1000.0
    drawn = 0
    for name in panel.columns:
        values = _column(rows, name)
        if not np.isfinite(values).any():
            continue
        drawn += 1
        if panel.table == "train" and len(values) > 40 and not name.endswith("_total"):
            axes.plot(frames, values, lw=0.6, alpha=0.3, color=f"C{drawn - 1}")
            values = smooth(values, max(len(values) // 20, 1))
        marker = "o" if panel.table == "validation" else None
        axes.plot(frames, values, lw=1.5, ms=3, marker=marker, color=f"C{drawn - 1}", label=name)
    if panel.band is not None:
        low, high = (_column(rows, name) for name in panel.band)
        axes.fill_between(frames, low, high, alpha=0.2, lw=0)
    if panel.columns == ("success",):
        axes.set_ylim(-0.02, 1.02)
    if drawn > 1:
        axes.legend(fontsize=7, frameon=False)


def draw_curves(folder: str | os.PathLike[str], path: str | os.PathLike[str]) -> Path:
    """Draw a run's learning curves.

    Args:
        folder: The run's folder with ``train.csv`` and ``validation.csv``.
        path: Image to write.

    Returns:
        The path.
    """
    tables = {
        name: CsvTable(Path(folder) / f"{name}.csv").read() for name in ("train", "validation")
    }
    still = len({row["frames"] for row in tables["train"]}) == 1 < len(tables["train"])
    clock, label = ("updates", "updates") if still else ("frames", "environment steps")
    figure = Figure(figsize=(11, 5.5), layout="constrained")
    grid = figure.subplots(2, 3).ravel()
    for axes, panel in zip(grid, PANELS):
        _draw(axes, panel, tables[panel.table], clock)
    for axes in grid[3:]:
        axes.set_xlabel(f"{label} [thousand]", fontsize=8)
    figure.savefig(path, dpi=130)
    return Path(path)
