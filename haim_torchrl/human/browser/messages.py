"""What a page may say: every message is checked here, and what fails the check is not used.

A message is a JSON object with a ``type``:

========== ============================================================== ==========================
``type``   further entries                                                from
========== ============================================================== ==========================
input      steering, throttle, brake, takeover, kind, t                   driver, 30 a second
pause      none                                                           driver
resume     none                                                           driver
quit       none                                                           driver
drive      none                                                           who wants the free seat
pong       t, the number of the server's ping                             everybody
seen       n, how many frames were received                               everybody
========== ============================================================== ==========================

No entry may be missing, and there are no others.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, NoReturn, TypeAlias, cast

from haim_torchrl.human.controls import Controls, DeviceKind

MAX_BYTES = 4096
"""Longest message."""
MAX_NUMBER = 2**53
"""Largest time and count; beyond it JavaScript's numbers are not exact."""

CommandName: TypeAlias = Literal["pause", "resume", "quit", "drive"]


@dataclass(frozen=True, slots=True)
class Input:
    """Positions of the controls.

    Attributes:
        controls: within their ranges.
        kind: what they are.
        time: the page's clock when they were read [ms].
    """

    controls: Controls
    kind: DeviceKind
    time: float


@dataclass(frozen=True, slots=True)
class Command:
    """A button of the page."""

    name: CommandName


@dataclass(frozen=True, slots=True)
class Pong:
    """Answer to a ping, with its number."""

    number: int


@dataclass(frozen=True, slots=True)
class Seen:
    """How many frames the page has received since it connected."""

    count: int


@dataclass(frozen=True, slots=True)
class Refusal:
    """A message that is not used.

    Attributes:
        reason: why, in one short sentence for the page.
    """

    reason: str


Message: TypeAlias = Input | Command | Pong | Seen


class _Bad(ValueError):
    """The message fails the check."""


def parse(text: str | bytes) -> Message | Refusal:
    """Check one message; nothing that a page sends raises an error.

    Args:
        text: what was received; only text may hold a message.

    Returns:
        The message, all of its numbers finite and within their ranges, or why there is none.

    Example:
        >>> parse('{"type": "pause"}')
        Command(name='pause')
        >>> parse('{"type": "pong", "t": NaN}')
        Refusal(reason='NaN is no number.')
    """
    if isinstance(text, bytes):
        return Refusal("Messages are text, not bytes.")
    if len(text) > MAX_BYTES:
        return Refusal(f"A message has at most {MAX_BYTES} bytes.")
    try:
        entries = json.loads(text, parse_constant=_refuse_constant)
    except _Bad as error:
        return Refusal(str(error))
    except (ValueError, RecursionError):
        return Refusal("This is no JSON.")
    if not isinstance(entries, dict):
        return Refusal("A message is a JSON object.")
    kind = entries.pop("type", None)
    known = _KINDS.get(kind) if isinstance(kind, str) else None
    if known is None:
        return Refusal(f"type is none of {', '.join(_KINDS)}.")
    names, make = known
    if entries.keys() != names:
        wanted = ", ".join(sorted(names)) or "no further entries"
        return Refusal(f"A message of type {kind} has {wanted}.")
    try:
        return make(entries)
    except _Bad as error:
        return Refusal(str(error))


def _input(entries: Mapping[str, Any]) -> Input:
    kind = entries["kind"]
    if kind not in ("keys", "gamepad", "wheel"):
        raise _Bad("kind is none of keys, gamepad, wheel.")
    takeover = entries["takeover"]
    if not isinstance(takeover, bool):
        raise _Bad("takeover is true or false.")
    controls = Controls(
        steering=_number(entries, "steering", -1.0, 1.0),
        throttle=_number(entries, "throttle", 0.0, 1.0),
        brake=_number(entries, "brake", 0.0, 1.0),
        takeover=takeover,
    )
    return Input(controls, cast(DeviceKind, kind), _number(entries, "t", 0.0, MAX_NUMBER))


def _number(entries: Mapping[str, Any], name: str, low: float, high: float) -> float:
    value = entries[name]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _Bad(f"{name} is a number.")
    if not low <= value <= high or not math.isfinite(value):
        raise _Bad(f"{name} lies in [{low:g}, {high:g}].")
    return float(value)


def _count(entries: Mapping[str, Any], name: str) -> int:
    if not isinstance(entries[name], int):
        raise _Bad(f"{name} is a whole number.")
    return int(_number(entries, name, 0, MAX_NUMBER))


def _refuse_constant(name: str) -> NoReturn:
    raise _Bad(f"{name} is no number.")


def _command(name: CommandName) -> Callable[[Mapping[str, Any]], Command]:
    return lambda entries: Command(name)


_KINDS: Final[dict[str, tuple[set[str], Callable[[Mapping[str, Any]], Message]]]] = {
    "input": ({"steering", "throttle", "brake", "takeover", "kind", "t"}, _input),
    "pause": (set(), _command("pause")),
    "resume": (set(), _command("resume")),
    "quit": (set(), _command("quit")),
    "drive": (set(), _command("drive")),
    "pong": ({"t"}, lambda entries: Pong(_count(entries, "t"))),
    "seen": ({"n"}, lambda entries: Seen(_count(entries, "n"))),
}
