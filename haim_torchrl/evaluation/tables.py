"""Results as tables for the terminal and as ``metrics.json``."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console
from rich.table import Table

from haim_torchrl.evaluation.metrics import Summary
from haim_torchrl.evaluation.statistics import Estimate

TABLE_COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("success", "success", 2),
    ("violations", "safety violation", 2),
    ("return", "return", 1),
    ("disturbance_rate", "disturbance rate", 4),
    ("disturbance_onsets_per_km", "onsets per km", 2),
    ("takeover_rate", "takeover rate", 3),
    ("out_of_road", "off road", 2),
    ("wrong_way", "wrong way", 2),
    ("timeout", "time-out", 2),
    ("speed", "speed [m/s]", 1),
)
"""Metric, heading and decimals of the main table: the columns of the paper's Table 1, then more."""


def cell(estimate: Estimate | None, decimals: int = 2) -> str:
    """An estimate with its interval, e.g. ``0.86 [0.74, 0.93]``; ``-`` when unknown.

    Example:
        >>> cell(Estimate(0.861, 0.742, 0.93, 50))
        '0.86 [0.74, 0.93]'
    """
    if estimate is None or math.isnan(estimate.value):
        return "-"
    text = f"{estimate.value:.{decimals}f}"
    if math.isnan(estimate.low) or math.isnan(estimate.high):
        return text
    return f"{text} [{estimate.low:.{decimals}f}, {estimate.high:.{decimals}f}]"


def main_table(
    rows: Mapping[str, Summary],
    title: str = "",
    training: Mapping[str, Mapping[str, str]] | None = None,
) -> Table:
    """The paper's Table 1 with confidence intervals over episodes, one column per driver.

    The metrics stand below each other since a terminal is not wide enough for them side by side.

    Args:
        rows: Driver or method to its figures.
        title: Title.
        training: Method to further entries (heading to text), such as training violations and
            data usage, shown above the metrics.
    """
    table = Table(title=title or None, title_justify="left")
    table.add_column("")
    for name in rows:
        table.add_column(name, justify="right")
    extra = training or {}
    for heading in dict.fromkeys(key for entries in extra.values() for key in entries):
        table.add_row(heading, *(extra.get(name, {}).get(heading, "-") for name in rows))
    table.add_row("episodes", *(str(row.overall["success"].count) for row in rows.values()))
    for metric, heading, decimals in TABLE_COLUMNS:
        table.add_row(heading, *(cell(row.overall.get(metric), decimals) for row in rows.values()))
    return table


def split_table(rows: Mapping[str, Summary], title: str = "success by road and obstacles") -> Table:
    """Success per block type and with and without obstacles, one column per driver."""
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for name in rows:
        table.add_column(name, justify="right")

    def lines(groups: list[Mapping[str, Estimate]], suffix: str) -> None:
        for key in sorted({key for group in groups for key in group}):
            count = max(group[key].count for group in groups if key in group)
            table.add_row(f"{key}{suffix} ({count})", *(cell(group.get(key)) for group in groups))

    lines([row.success_by_block for row in rows.values()], "")
    lines([row.success_by_obstacles for row in rows.values()], " obstacles")
    return table


def print_tables(*tables: Table, stream: TextIO | None = None) -> None:
    """Print tables, no narrower than they need to be where there is no terminal."""
    console = Console(file=stream)
    if not console.is_terminal:
        console = Console(file=stream, width=160)
    for table in tables:
        console.print(table)


def write_metrics(path: str | os.PathLike[str], contents: Mapping[str, Any]) -> Path:
    """Write results as JSON; NaN becomes null.

    Raises:
        FileExistsError: If the file is there already: results are never overwritten.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(_without_nan(contents), indent=2, allow_nan=False) + "\n"
    try:
        with target.open("x") as stream:
            stream.write(text)
    except FileExistsError:
        raise FileExistsError(
            f"{target} exists and results are never overwritten; choose another folder"
        ) from None
    return target


def _without_nan(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _without_nan(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(item) for item in value]
    return value
