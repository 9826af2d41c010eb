"""What each method took: minutes, steps, and the command that makes one of its runs."""

from __future__ import annotations

from haim_torchrl.evaluation.statistics import RESAMPLES
from haim_torchrl.evaluation.tables import cell
from haim_torchrl.report.methods import Method
from haim_torchrl.report.paper import known
from haim_torchrl.report.table import GAP, ReportTable
from haim_torchrl.report.tables import FRAMES, MENTOR_STEPS, MINUTES, Methods, figure, papers_text


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
    if run.settings.demonstrations is not None:
        parts.append(f"demonstrations={run.settings.demonstrations}")
    if run.settings.world not in (None, "platoon"):
        parts.append(f"env={run.settings.world}")
    return " ".join(parts)
