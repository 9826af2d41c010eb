"""How sure it is that one method is better than the others, and what each of them took."""

from __future__ import annotations

from collections.abc import Sequence

from haim_torchrl.evaluation.statistics import RESAMPLES, Estimate
from haim_torchrl.evaluation.tables import cell
from haim_torchrl.report.methods import Method
from haim_torchrl.report.paper import known
from haim_torchrl.report.statistics import probability_of_improvement
from haim_torchrl.report.table import GAP, ReportTable
from haim_torchrl.report.tables import FRAMES, MENTOR_STEPS, MINUTES, Methods, figure, papers_text

COMPARED = ("success", "return")
"""Measures that the probability of improvement is given for."""


def improvement_table(
    methods: Methods, reference: str, level: float = 0.95, resamples: int = RESAMPLES
) -> ReportTable:
    """Probability that a training of the reference ends higher than one of each other method.

    Args:
        methods: Runs by method.
        reference: Name of the method that is compared with the others.
        level: Confidence level.
        resamples: Bootstrap resamples.
    """
    ours = known(reference).title
    columns = ["compared with", "pairs of seeds", *(f"P(higher {m})" for m in COMPARED)]
    notes = [
        f"Probability that a training of {ours} ends with a higher figure on the held-out "
        "scenarios than one of the other method: the share of pairs of seeds, ties counting half. "
        f"Brackets: {100 * level:.0f} % of a bootstrap that draws the seeds of each method, and "
        "scenarios for both together."
    ]
    rows, numbers = [], []
    base = methods.get(reference)
    if base is None:
        notes.append(f"There is no finished run of {reference} to compare with.")
    for name, other in methods.items() if base is not None else ():
        if other is base or not other.trained or base is None:
            continue
        shared = set(base.scenarios()) & set(other.scenarios()) if _same_world(base, other) else ()
        title = known(name).title
        if not shared:
            notes.append(f"{title} was not tested on the same scenarios of the same world.")
        estimates = [
            probability_of_improvement(
                base.scores(measure, shared), other.scores(measure, shared), level, resamples
            )
            for measure in COMPARED
        ]
        rows.append([title, str(base.seeds * other.seeds), *map(cell, estimates)])
        numbers.append({"method": name, "reference": reference, **_fields(estimates)})
    title = f"Is {ours} better?"
    return ReportTable("improvement", title, columns, rows, notes, numbers)


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


def effort_table(methods: Methods, level: float = 0.95, resamples: int = RESAMPLES) -> ReportTable:
    """Minutes and steps of each method, with the command that makes one of its runs."""
    columns = ["method", "seeds", "minutes", "paper", "environment steps", "mentor steps"]
    rows, numbers = [], []
    for name, method in methods.items():
        if not method.trained:
            continue
        row = known(name)
        measures = (MINUTES, FRAMES, MENTOR_STEPS)
        minutes, frames, mentor = (figure(method, m, level, resamples) for m in measures)
        seeds = ", ".join(str(run.seed) for run in method.runs)
        paper = papers_text((row.paper or {}).get("minutes"))
        command = _command(method)
        rows.append(
            [row.title, seeds, cell(minutes, 1), paper, cell(frames, 0), cell(mentor, 0), command]
        )
        numbers.append(
            {
                "method": name,
                "seeds": seeds,
                "minutes": minutes.value,
                "frames": frames.value,
                "mentor_steps": mentor.value,
                "command": command,
            }
        )
    note = (
        "Minutes of a training with its validations, without the test at its end, on the machine "
        "of the runs."
    )
    columns = [*columns, "command"]
    return ReportTable("effort", "What each method took", columns, rows, [note], numbers)


def _command(method: Method) -> str:
    """The command of the first seed; settings that its recipe's defaults do not have may differ."""
    run, command = method.runs[0], known(method.name).command
    if not command:
        return GAP
    parts = [command, f"seed={run.seed}"]
    if run.settings.total_frames is not None:
        parts.append(f"total_frames={run.settings.total_frames}")
    if run.settings.world not in (None, "platoon"):
        parts.append(f"env={run.settings.world}")
    return " ".join(parts)
