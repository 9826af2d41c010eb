"""Finished runs in a compact form, from their folders or from a published ``runs.json``.

What is read from a folder is rounded and thinned at once, so that a report made from the published
form is the same to the last digit.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from haim_torchrl.evaluation.training_log import CsvTable
from haim_torchrl.report.settings import Settings, evaluated_set, read_settings

FORMAT, VERSION = "haim_torchrl runs", 1
RESULT_FILE = "metrics.json"
"""What a run writes last: a folder without it holds no finished run."""

EPISODE_COLUMNS = (
    "scenario",
    "outcome",
    "violations",
    "reward",
    "steps",
    "hard_brakes",
    "hard_brake_onsets",
    "disturbance_cost",
    "distance",
    "duration",
    "progress",
)
VALIDATION_COLUMNS = ("success", "return", "violations", "disturbance_rate")
COURSE_POINTS = 60
"""Rows of ``train.csv`` that are kept."""

Columns = dict[str, list[Any]]


class RunFileError(ValueError):
    """A file that holds no finished run; the message says which and why in one sentence."""


@dataclass(frozen=True)
class FinishedRun:
    """A run that came to its end.

    Attributes:
        name: Method.
        seed: Seed of the training.
        training: Totals of the training by name; empty for who was not trained.
        settings: What it was trained and tested with, as far as it is known.
        checkpoint: Steps after which the chosen policy was kept; None when unknown.
        episodes: Test episodes, a list for each of :data:`EPISODE_COLUMNS`.
        validation: Validations: ``frames``, ``mentor_steps`` so far, :data:`VALIDATION_COLUMNS`.
        course: The training: ``frames``, and ``mentor_steps`` and ``violations`` so far.
        folder: Where it was read from; None for a published one.
    """

    name: str
    seed: int
    training: Mapping[str, float] = field(default_factory=dict)
    settings: Settings = field(default_factory=Settings)
    checkpoint: int | None = None
    episodes: Columns = field(default_factory=dict)
    validation: Columns = field(default_factory=dict)
    course: Columns = field(default_factory=dict)
    folder: Path | None = field(default=None, compare=False)

    def total(self, name: str) -> float:
        """A total of the training; NaN where it was not counted."""
        value = self.training.get(name)
        return math.nan if value is None else float(value)

    def scenarios(self) -> list[int]:
        """Scenarios of the test; places in it where a simulator does not number them."""
        numbers = [int(number) for number in self.episodes["scenario"]]
        return numbers if len(set(numbers)) == len(numbers) else list(range(len(numbers)))

    def published(self) -> dict[str, Any]:
        """Plain values for ``runs.json``, without what only this machine knows."""
        contents = asdict(replace(self, folder=None))
        del contents["folder"]
        return contents


def _short(value: Any) -> Any:
    """A number with six digits, whole ones as int; NaN as None; text as it is."""
    if isinstance(value, (bool, str)) or value is None:
        return value
    number = float(value)
    if not math.isfinite(number):
        return None
    return int(number) if number.is_integer() else float(f"{number:.6g}")


def _numbers(rows: Sequence[Mapping[str, str]], column: str) -> list[float]:
    return [float(row.get(column) or math.nan) for row in rows]


def _read_course(folder: Path) -> tuple[Columns, Columns]:
    """The validations and the thinned course of a training; empty without their files."""
    rows, checks = (CsvTable(folder / f"{name}.csv").read() for name in ("train", "validation"))
    frames, mentor = _numbers(rows, "frames"), _numbers(rows, "mentor_steps_total")
    validation: Columns = {}
    if checks:
        at = _numbers(checks, "frames")
        so_far = np.interp(at, [0.0, *frames], [0.0, *mentor]).tolist() if rows else at
        validation = {"frames": at, "mentor_steps": so_far}
        validation |= {name: _numbers(checks, name) for name in VALIDATION_COLUMNS}
    course: Columns = {}
    if rows:
        columns = (frames, mentor, _numbers(rows, "violations_total"))
        kept = np.unique(np.linspace(0, len(rows) - 1, COURSE_POINTS).round().astype(int))
        course = {
            name: [column[row] for row in kept]
            for name, column in zip(("frames", "mentor_steps", "violations"), columns)
        }
    return _rounded(validation), _rounded(course)


def _rounded(columns: Mapping[str, Sequence[Any]]) -> Columns:
    return {name: [_short(value) for value in values] for name, values in columns.items()}


def _episodes(rows: Sequence[Mapping[str, Any]]) -> Columns:
    if not rows:
        raise KeyError("episodes")
    return _rounded({name: [row[name] for row in rows] for name in EPISODE_COLUMNS})


def _load(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise RunFileError(f"{path} cannot be read ({error}); it is left out") from None


def read_result(path: Path) -> list[FinishedRun]:
    """The run behind a ``metrics.json``, or the drivers without policy of a test.

    Args:
        path: The file; CSV files and settings are looked for beside it.

    Raises:
        RunFileError: If something that every run writes is not in it.
    """
    contents, folder = _load(path), path.parent
    try:
        settings = read_settings(folder)
        if "drivers" in contents:  # of recipes/evaluate.py: how the mentor itself does
            return [
                FinishedRun(name, 0, {}, settings, episodes=_episodes(result["episodes"]))
                for name, result in contents["drivers"].items()
                if "policy" not in name and evaluated_set(folder) == "test"
            ]
        validation, course = _read_course(folder)
        chosen = contents["checkpoint"].get("frames")
        run = FinishedRun(
            str(contents["name"]),
            int(contents["seed"]),
            {name: _short(value) for name, value in contents["training"].items()},
            settings,
            None if chosen is None else int(chosen),
            _episodes(contents["episodes"]),
            validation,
            course,
            folder,
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        what = f"has no {error}" if isinstance(error, KeyError) else f"is not a run's ({error})"
        raise RunFileError(f"{path} {what}; it is left out") from None
    return [run]


def read_published(path: Path) -> list[FinishedRun]:
    """The runs of a ``runs.json``.

    Raises:
        RunFileError: If it is none, or of a later version.
    """
    contents = _load(path)
    if not isinstance(contents, dict) or contents.get("format") != FORMAT:
        raise RunFileError(f"{path} is no runs.json of a report; it is left out")
    if contents.get("version") != VERSION:
        raise RunFileError(f"{path} has version {contents.get('version')}, which is not known here")
    try:
        return [
            FinishedRun(**{**run, "settings": Settings(**run["settings"])})
            for run in contents["runs"]
        ]
    except (KeyError, TypeError) as error:
        raise RunFileError(f"{path} is damaged ({error}); it is left out") from None


def publish(runs: Sequence[FinishedRun], path: str | os.PathLike[str]) -> Path:
    """Write runs as a ``runs.json``, a line for each, and return its path."""
    lines = [json.dumps(run.published(), separators=(",", ":"), allow_nan=False) for run in runs]
    head = f'{{"format": "{FORMAT}", "version": {VERSION}, "runs": [\n'
    Path(path).write_text(head + ",\n".join(lines) + "\n]}\n")
    return Path(path)


def result_files(folder: Path) -> Iterator[Path]:
    """The last result of each run below a folder: one that was gone on with has several."""
    latest: dict[Path, Path] = {}
    for path in sorted(folder.rglob("metrics*.json"), key=lambda path: (len(path.name), path.name)):
        latest[path.parent] = path
    yield from (latest[parent] for parent in sorted(latest))
