"""A check: something looked at, what was found, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias

Status: TypeAlias = Literal["ok", "info", "warn", "fail"]
"""``info`` is neither good nor bad; ``warn`` concerns some uses; after ``fail`` no run works."""


@dataclass(frozen=True)
class Check:
    """What was found.

    Attributes:
        name: what was looked at.
        status: how good that is.
        detail: what was found, in plain words.
        fix: what to do about it; empty if there is nothing to do.
    """

    name: str
    status: Status
    detail: str
    fix: str = ""


Checking: TypeAlias = Callable[[], "Check | list[Check]"]


def run_checks(checkings: Iterable[Checking]) -> list[Check]:
    """Make checks one after the other; one that breaks has failed, and the next is made.

    Args:
        checkings: functions that look at something.

    Returns:
        Their findings, in order.
    """
    found: list[Check] = []
    for checking in checkings:
        try:
            result = checking()
        except Exception as error:  # whatever is broken here, the other checks are to be made
            name = getattr(checking, "__name__", "check").replace("_", " ")
            first = (str(error).splitlines() or [""])[0][:200]
            fix = "mend the packages first" if isinstance(error, ImportError) else ""
            result = Check(name, "fail", f"the check broke: {type(error).__name__}: {first}", fix)
        found += result if isinstance(result, list) else [result]
    return found
