"""``python -m haim_torchrl.coach runs/<folder>``: how the takeovers of a recorded run were."""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from haim_torchrl.data.session import Session, SessionError, read_session
from haim_torchrl.human.coach_report import CoachReport, make_report
from haim_torchrl.human.takeovers import TAKEOVERS_FILE, TakeoverError, read_takeovers


def main(arguments: Sequence[str] | None = None) -> None:
    """The command: print the report of a run.

    Raises:
        SystemExit: With code 2 after one sentence, if there is nothing to report.
    """
    parser = argparse.ArgumentParser(
        prog="python -m haim_torchrl.coach",
        description="Says how a run's takeovers were, from its session and its takeovers.jsonl.",
    )
    parser.add_argument("run", type=Path, help="a run's folder, or a session file")
    parser.add_argument("--time-step", type=float, default=0.1, help="duration of a step [s]")
    given = parser.parse_args(arguments)
    try:
        report = report_of(given.run, time_step=given.time_step)
    except (SessionError, TakeoverError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    print(report)


def report_of(run: Path, **known: Any) -> CoachReport:
    """The report of a run, from its session, and from the takeovers that a coach kept.

    Args:
        run: A run's folder, or a session file.
        **known: Further arguments of :func:`~haim_torchrl.human.coach_report.make_report`.

    Raises:
        SessionError, TakeoverError: If a file cannot be read.
    """
    session = _read(run)
    kept = session.path.with_name(TAKEOVERS_FILE)
    return make_report(read_takeovers(kept) if kept.is_file() else [], session, **known)


def _read(run: Path) -> Session:
    """The session of a run: one file, or several where it was gone on with in another."""
    first = read_session(run)
    if not run.is_dir():
        return first
    parts = {file.stem.rpartition("_")[2]: file for file in run.glob("session_*.jsonl")}
    numbers = sorted(int(number) for number in parts if number.isdecimal())
    rest = [read_session(parts[str(number)]).episodes for number in numbers]
    return replace(first, episodes=[*first.episodes, *itertools.chain(*rest)])


if __name__ == "__main__":
    main()
