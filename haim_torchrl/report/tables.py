"""The paper's Tables 1 and 2 from runs, the paper's own figures beside ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from haim_torchrl.evaluation.statistics import RESAMPLES, Estimate
from haim_torchrl.evaluation.tables import cell
from haim_torchrl.report.methods import Method
from haim_torchrl.report.paper import Row, known, rows
from haim_torchrl.report.statistics import Scores, crossed_interval
from haim_torchrl.report.table import GAP, ReportTable

Methods = Mapping[str, Method]


class Measure(NamedTuple):
    """A column of a table.

    Attributes:
        key: Its name in CSV files and in ``paper.yaml``.
        heading: Its name in a table.
        decimals: Digits shown.
        scores: What it is of a method.
    """

    key: str
    heading: str
    decimals: int
    scores: Callable[[Method], Scores]


def _test(key: str, heading: str, decimals: int) -> Measure:
    return Measure(key, heading, decimals, lambda method: method.scores(key))


def _training(key: str, heading: str, total: str, decimals: int = 0, scale: float = 1.0) -> Measure:
    return Measure(key, heading, decimals, lambda method: method.totals(total, scale))


RETURN = _test("return", "test return", 1)
VIOLATIONS = _test("violations", "test safety violation", 2)
DISTURBANCE = _test("disturbance_rate", "test disturbance rate", 4)
SUCCESS = _test("success", "test success rate", 2)
FRAMES = _training("frames", "training data usage", "frames")
MENTOR_STEPS = _training("mentor_steps", "mentor steps", "mentor_steps")
MINUTES = _training("minutes", "minutes", "seconds", 1, 1.0 / 60.0)

TABLE1 = (
    _training("training_violations", "training safety violations", "violations"),
    FRAMES,
    RETURN,
    VIOLATIONS,
    DISTURBANCE,
    SUCCESS,
    MENTOR_STEPS,
    _training("takeovers", "takeovers", "takeovers"),
    MINUTES,
)
TABLE2 = (RETURN, VIOLATIONS._replace(heading="test cost"), SUCCESS, DISTURBANCE)

STATISTIC = (
    "Ours: a seed's figure is over all of its held-out scenarios (means; the disturbance rate is "
    "braking steps over steps), and the table has the interquartile mean of the seeds' figures, "
    "since one over single episodes would leave out the failures. Brackets: {level:.0f} % of a "
    "bootstrap that draws seeds and scenarios, crossed; totals of the training have seeds only. "
    "With few seeds they are rather too narrow, and one that is a point says that nothing differed "
    "in the sample."
)
PAPERS = (
    "Paper: mean ± standard deviation over its repetitions, on MetaDrive with a person as the "
    "mentor (Huang et al. 2024)."
)


def figure(
    method: Method, measure: Measure, level: float = 0.95, resamples: int = RESAMPLES
) -> Estimate:
    """A measure of a method with its interval; no interval where all seeds have the same total."""
    scores = measure.scores(method)
    estimate = crossed_interval(scores, level, resamples)
    if scores.numerators.shape[1] == 1 and estimate.low == estimate.high:
        return Estimate(estimate.value, math.nan, math.nan, estimate.count)
    return estimate


def papers_text(numbers: tuple[float, ...] | None) -> str:
    """A figure of the paper, such as ``0.85 ± 0.03``.

    Example:
        >>> papers_text((0.0023, 0.00072)), papers_text(None)
        ('0.0023 ± 0.00072', '-')
    """
    if numbers is None:
        return GAP
    return " ± ".join(np.format_float_positional(number, trim="-") for number in numbers)


def build_table(
    key: str,
    title: str,
    table_rows: Sequence[Row],
    measures: Sequence[Measure],
    methods: Methods,
    level: float = 0.95,
    resamples: int = RESAMPLES,
) -> ReportTable:
    """A table of methods; one without runs keeps its row, as a gap with a note.

    Args:
        key: File name of its CSV form.
        title: Title.
        table_rows: Rows.
        measures: Columns. The paper's figures stand beside those that any row has some for.
        methods: Runs by method.
        level: Confidence level.
        resamples: Bootstrap resamples.
    """
    beside = {m.key for m in measures if any(m.key in (row.paper or {}) for row in table_rows)}
    columns, cells, numbers = ["category", "method", "seeds"], [], []
    if not any(row.category for row in table_rows):
        columns = columns[1:]
    for measure in measures:
        columns += [measure.heading, "paper"] if measure.key in beside else [measure.heading]
    for row in table_rows:
        method = methods.get(row.name)
        texts = [row.category, row.title, str(method.seeds if method else 0)]
        entry: dict[str, Any] = {"method": row.name, "seeds": method.seeds if method else 0}
        for measure in measures:
            estimate = figure(method, measure, level, resamples) if method else None
            texts.append(cell(estimate, measure.decimals))
            entry |= _numbers(measure.key, estimate)
            if measure.key in beside:
                figures = (row.paper or {}).get(measure.key)
                texts.append(papers_text(figures))
                for name, number in zip(("paper", "paper_sd"), (*(figures or ()), None, None)):
                    entry[f"{measure.key}_{name}"] = number
        cells.append(texts[-len(columns) :])
        numbers.append(entry)
    notes = [STATISTIC.format(level=100 * level), *_notes(table_rows, methods)]
    return ReportTable(key, title, columns, cells, [*notes, PAPERS], numbers)


def _numbers(key: str, estimate: Estimate | None) -> dict[str, float | None]:
    fields = {} if estimate is None else estimate.as_dict()
    names = {key: "value", f"{key}_low": "low", f"{key}_high": "high"}
    return {name: fields.get(field) for name, field in names.items()}


def _notes(table_rows: Sequence[Row], methods: Methods) -> list[str]:
    """What a reader must know: gaps, single seeds, and the worlds of the runs."""
    present = [row for row in table_rows if row.name in methods]
    notes = [
        f"{row.title}: no finished run was given; one is made by `{row.command}`."
        for row in table_rows
        if row.name not in methods
    ]
    single = [row.title for row in present if methods[row.name].seeds == 1]
    if single:
        notes.append(f"One seed, so that intervals are over scenarios only: {', '.join(single)}.")
    worlds = {str(run.settings.world or "unknown") for m in methods.values() for run in m.runs}
    if worlds:
        notes.append(f"World of our runs: {', '.join(sorted(worlds))}.")
    return notes


def table1(methods: Methods, level: float = 0.95, resamples: int = RESAMPLES) -> ReportTable:
    """The paper's Table 1; methods that it has not follow at its end."""
    names = {row.name for table in ("table1", "table2") for row in rows(table)}
    others = [
        replace(known(name), category=known(name).category or "not in the paper")
        for name in methods
        if name not in names
    ]
    title = "Table 1: methods on the held-out scenarios, without mentor"
    lines = [*rows("table1"), *others]
    return build_table("table1", title, lines, TABLE1, methods, level, resamples)


def table2(methods: Methods, level: float = 0.95, resamples: int = RESAMPLES) -> ReportTable:
    """The paper's Table 2: ablations."""
    title = "Table 2: ablations on the held-out scenarios"
    return build_table("table2", title, rows("table2"), TABLE2, methods, level, resamples)
