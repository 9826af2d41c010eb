"""How sure it is that one method is better than the others."""

from __future__ import annotations

from collections.abc import Sequence

from haim_torchrl.evaluation.statistics import RESAMPLES, Estimate
from haim_torchrl.evaluation.tables import cell
from haim_torchrl.report.methods import Method
from haim_torchrl.report.paper import known
from haim_torchrl.report.statistics import probability_of_improvement
from haim_torchrl.report.table import ReportTable
from haim_torchrl.report.tables import Methods

COMPARED = {
    "success": ("P(higher success)", 1.0),
    "return": ("P(higher return)", 1.0),
    "disturbance_rate": ("P(lower disturbance rate)", -1.0),
}
"""Measures that are compared: heading, and the sign of what is better."""


def improvement_table(
    methods: Methods, reference: str, level: float = 0.95, resamples: int = RESAMPLES
) -> ReportTable:
    """Probability that a training of the reference ends better than one of each other method.

    Args:
        methods: Runs by method.
        reference: Name of the method that is compared with the others.
        level: Confidence level.
        resamples: Bootstrap resamples.
    """
    ours, base = known(reference).title, methods.get(reference)
    key, title = "improvement", f"Is {ours} better?"
    columns = ["compared with", "pairs of seeds", *(heading for heading, _ in COMPARED.values())]
    if base is None:
        gap = f"There is no finished run of {reference} to compare with."
        return ReportTable(key, title, columns, [], [gap])
    notes = [
        f"Probability that a training of {ours} ends with a better figure on the held-out "
        "scenarios than one of the other method: the share of pairs of seeds, ties counting half. "
        f"Brackets: {100 * level:.0f} % of a bootstrap that draws the seeds of each method, and "
        "scenarios for both together."
    ]
    rows, numbers = [], []
    for name, other in methods.items():
        if other is base or not other.trained:
            continue
        shared = set(base.scenarios()) & set(other.scenarios()) if _same_world(base, other) else ()
        name_shown = known(name).title
        if not shared:
            notes.append(f"{name_shown} was not tested on the same scenarios of the same world.")
        estimates = []
        for measure, (_, sign) in COMPARED.items():
            ours_scores, theirs = (m.scores(measure, shared).scaled(sign) for m in (base, other))
            estimates.append(probability_of_improvement(ours_scores, theirs, level, resamples))
        rows.append([name_shown, str(base.seeds * other.seeds), *map(cell, estimates)])
        numbers.append({"method": name, "reference": reference, **_fields(estimates)})
    return ReportTable(key, title, columns, rows, notes, numbers)


def _fields(estimates: Sequence[Estimate]) -> dict[str, float | int | None]:
    return {
        f"{measure}_{key}": number
        for measure, estimate in zip(COMPARED, estimates)
        for key, number in estimate.as_dict().items()
        if key != "count"
    }


def _same_world(first: Method, second: Method) -> bool:
    worlds = {run.settings.world for method in (first, second) for run in method.runs}
    return len(worlds) == 1
