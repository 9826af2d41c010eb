"""Findings as text for a person and as JSON for a program."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from haim_torchrl.doctor.check import Check
from haim_torchrl.doctor.mentors import Row

Sections = Mapping[str, Sequence[Check]]
COLOURS = {"ok": 32, "info": 36, "warn": 33, "fail": 31}


def healthy(sections: Sections, asked_for: Row | None = None) -> bool:
    """Whether everything works that is needed.

    Args:
        sections: findings by subject.
        asked_for: the mentor in question; None if any may drive.
    """
    failed = any(check.status == "fail" for checks in sections.values() for check in checks)
    return not failed and (asked_for is None or asked_for.works)


def as_json(sections: Sections, mentors: Sequence[Row], ok: bool) -> str:
    """All findings: ``ok``, ``checks`` (each with its ``section``), ``mentors``."""
    checks = [
        {"section": name} | asdict(check) for name, found in sections.items() for check in found
    ]
    document = {"ok": ok, "checks": checks, "mentors": [asdict(row) for row in mentors]}
    return json.dumps(document, indent=2)


def as_text(
    sections: Sections, mentors: Sequence[Row], ok: bool, *, width: int = 100, colour: bool = False
) -> str:
    """All findings by subject, then the table of mentors.

    Args:
        sections: findings by subject.
        mentors: who could drive.
        ok: whether everything works that is needed.
        width: of the terminal.
        colour: whether it shows colours.
    """
    lines = []
    for name, checks in sections.items():
        lines += [name, *(_line(check, width, colour) for check in checks), ""]
    lines += ["mentors", _row("mentor", "works", "why not", "fix", width)]
    for row in mentors:
        works = "yes" if row.works else "no"
        lines.append(_row(row.mentor, works, row.why or "-", row.fix or "-", width))
    problems = [check for checks in sections.values() for check in checks if check.status == "fail"]
    end = "everything that is needed works"
    if not ok:
        lost = [check.name for check in problems]
        if not lost:
            lost = [f"mentor={row.mentor}" for row in mentors if not row.works]
        end = f"does not work: {', '.join(lost)}"
    return "\n".join([*lines, "", _paint(end, "ok" if ok else "fail", colour)])


def _line(check: Check, width: int, colour: bool) -> str:
    room = max(width - 37, 30)
    detail = textwrap.wrap(check.detail, room) or [""]
    if check.fix:
        detail += textwrap.wrap(f"-> {check.fix}", room, subsequent_indent="   ")
    # A long name has a line of its own.
    name = f"{check.name:<28} " if len(check.name) <= 28 else f"{check.name}\n{'':36}"
    status = _paint(f"{check.status:<4}", check.status, colour)
    return f"  {status}  {name}" + f"\n{'':37}".join(detail)


def _row(mentor: str, works: str, why: str, fix: str, width: int) -> str:
    room = max((width - 21) // 2, 20)
    left, right = textwrap.wrap(why, room), textwrap.wrap(fix, room)
    lines = []
    for i in range(max(len(left), len(right))):
        one, two = left[i : i + 1], right[i : i + 1]
        head = (mentor, works) if i == 0 else ("", "")
        text = f"  {head[0]:<10} {head[1]:<6} {(one or [''])[0]:<{room}} {(two or [''])[0]}"
        lines.append(text.rstrip())
    return "\n".join(lines)


def _paint(text: str, status: str, colour: bool) -> str:
    return f"\033[{COLOURS[status]}m{text}\033[0m" if colour else text
