"""A training session as a file: what agent and mentor did, step by step, written as it goes.

JSON Lines: a header, then a line for each episode that begins and one for each step. Each line ends
with a CRC-32 of itself and of all lines before it, so that a line that was edited, removed, added
or moved is noticed. Numbers are written with all their digits: what is read is what was driven.
"""

from __future__ import annotations

import json
import os
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

FORMAT = "haim_torchrl session"
VERSION = 1
SESSION_FILE = "session.jsonl"
"""Name of the session in a run's folder."""
FIELDS = {
    "episode": "number of the episode in this file, from 0",
    "scenario": "seed of the episode's scenario; null where the simulator has none",
    "random_state": "of the simulator's generator before the episode was drawn",
    "step": "number of the step in its episode, from 0",
    "action_agent": "what the agent proposed, in the units of the environment's action",
    "action_mentor": "what the mentor did, zeros where it did not drive",
    "action": "what the simulator executed",
    "intervention": "the mentor drove the step",
    "takeover_start": "first step of a takeover",
    "done": "the episode ended with this step",
    "device_ok": "the mentor's input device worked; true for machines",
    "latency_ms": "delay of the mentor's input [ms]; left out where it is not known",
    "policy_version": "of the agent; left out where it is not told",
    "observation": "CRC-32 of what the agent saw before the step; left out where it saw nothing",
    "time": "seconds since 1970-01-01 UTC",
    "crc": "CRC-32 of this line without the entry crc, continued from the line before",
}
"""Meaning of the entries of a line, repeated in the header of each file."""

_PREFIX = f'{{"format":"{FORMAT}"'.encode()
_SEAL = b',"crc":"'


class SessionError(ValueError):
    """A session that cannot be read or driven again; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class SessionStep:
    """One step; :data:`FIELDS` says what each entry means.

    Actions are ``[A]`` as tuples of Python floats, which hold float32 and float64 exactly.
    """

    episode: int
    scenario: int | None
    step: int
    action_agent: tuple[float, ...]
    action_mentor: tuple[float, ...]
    action: tuple[float, ...]
    intervention: bool
    takeover_start: bool
    done: bool
    device_ok: bool
    time: float
    latency_ms: float | None = None
    policy_version: int | float | str | None = None
    observation: str | None = None


@dataclass(frozen=True)
class SessionEpisode:
    """One episode.

    Attributes:
        number: Number in the file, from 0.
        scenario: Seed of its scenario, if the simulator has such a thing.
        random_state: State of the simulator's generator before the episode was drawn, if it has
            one.
        steps: Its steps, at least one.
    """

    number: int
    scenario: int | None
    random_state: dict[str, Any] | None
    steps: list[SessionStep]


@dataclass(frozen=True)
class Session:
    """A session that was read. Its length is its number of steps.

    Attributes:
        path: File that it was read from.
        header: Versions of the packages, ``seed``, ``started``, ``settings``, fields.
        episodes: Its episodes in the order in which they were driven.
    """

    path: Path
    header: dict[str, Any]
    episodes: list[SessionEpisode]

    def __len__(self) -> int:
        return sum(len(episode.steps) for episode in self.episodes)

    def steps(self) -> Iterator[SessionStep]:
        """All steps in the order in which they were driven."""
        for episode in self.episodes:
            yield from episode.steps


def find_session(path: str | os.PathLike[str]) -> Path:
    """The session file meant by a path, which may be the file or the folder of its run.

    Raises:
        SessionError: If there is none.
    """
    given = Path(path).expanduser()
    file = given / SESSION_FILE if given.is_dir() else given
    if not file.is_file():
        raise SessionError(
            f"session {file} does not exist; give a session file, or the folder of a run that "
            "wrote one (record=true)"
        )
    return file


def next_free(path: Path) -> Path:
    """``path`` if it is free, else with the first free number, such as ``session_2.jsonl``."""
    free, number = path, 2
    while free.exists():
        free, number = path.with_name(f"{path.stem}_{number}{path.suffix}"), number + 1
    return free


def read_session(path: str | os.PathLike[str]) -> Session:
    """Read a session whole.

    A file that was cut in the middle of its last line, as by a crash, is read without that line,
    with a warning. The file is not changed.

    Args:
        path: A session file, or a run's folder that holds one.

    Raises:
        SessionError: If it is missing, foreign, of another version, or was changed after it was
            written; the message names the line.
    """
    file = find_session(path)
    header: dict[str, Any] | None = None
    episodes: list[SessionEpisode] = []
    end = steps = 0
    for line in read_lines(file):
        entry, end = line.entry, line.end
        if header is None:
            header = entry
        elif line.kind == "step":
            actions = {k: tuple(entry[k]) for k in ("action_agent", "action_mentor", "action")}
            episodes[-1].steps.append(SessionStep(**{**entry, **actions}))
            steps += 1
        else:
            episodes.append(
                SessionEpisode(entry["episode"], entry["scenario"], entry["random_state"], [])
            )
    if header is None:
        raise SessionError(f"session {file} was cut before its first step; it holds nothing")
    if end < file.stat().st_size:
        warnings.warn(
            f"session {file} was cut in the middle of its last line, which is left out; the "
            f"{steps} steps before it are kept.",
            stacklevel=2,
        )
    return Session(file, header, [episode for episode in episodes if episode.steps])


class Line(NamedTuple):
    """One line of a session.

    Attributes:
        kind: ``"header"``, ``"episode"`` or ``"step"``.
        entry: What stands in it, without its checksum.
        checksum: Of it and all lines before.
        end: Bytes of the file up to and including it.
    """

    kind: str
    entry: dict[str, Any]
    checksum: int
    end: int


def encode(value: Any) -> str:
    """JSON of a value, arrays among it as lists."""
    return json.dumps(value, separators=(",", ":"), default=lambda array: array.tolist())


def seal(text: str, checksum: int = 0) -> tuple[bytes, int]:
    """A line of the file, and the checksum up to and including it.

    Args:
        text: What stands in it, a JSON object.
        checksum: That of the line before.
    """
    body = text[:-1].encode()
    checksum = zlib.crc32(body, checksum)
    return b'%b%b%08x"}\n' % (body, _SEAL, checksum), checksum


def read_lines(file: Path) -> Iterator[Line]:
    """The lines of a session one by one, each held against its checksum; a cut one is left out.

    Raises:
        SessionError: As :func:`read_session`.
    """
    checksum = end = 0
    with file.open("rb") as stream:
        for number, raw in enumerate(stream, 1):
            if number == 1 and not raw.startswith(_PREFIX) and not _PREFIX.startswith(raw):
                raise SessionError(
                    f"session {file} was not written by this project: its line 1 is no header"
                )
            if not raw.endswith(b"\n"):
                return
            body, _, tail = raw.rpartition(_SEAL)
            checksum = zlib.crc32(body, checksum)
            if tail != b'%08x"}\n' % checksum:
                raise SessionError(
                    f"line {number} of session {file} is not as it was written: it, or a line "
                    "before it, was edited, removed or added; use the file as it was recorded"
                )
            entry = json.loads(body + b"}")
            end += len(raw)
            if number == 1 and entry["version"] != VERSION:
                raise SessionError(
                    f"line 1 of session {file} names the format version {entry['version']} but "
                    f"this version of haim_torchrl reads {VERSION}; use the version that wrote it"
                )
            kind = "header" if number == 1 else "step" if "step" in entry else "episode"
            yield Line(kind, entry, checksum, end)


def fingerprint(observation: np.ndarray) -> str:
    """CRC-32 of an observation's bytes, eight hexadecimal digits.

    Example:
        >>> fingerprint(np.zeros(2, np.float32)), fingerprint(np.array([0.0, 1e-45], np.float32))
        ('6522df69', 'dd9eb80c')
    """
    return f"{zlib.crc32(np.ascontiguousarray(observation).data):08x}"


def scenario_of(simulator: Any) -> int | None:
    """Seed of the scenario that a simulator is in; None for one without scenarios.

    Args:
        simulator: The unwrapped simulator; one with scenarios has a method ``scenario_labels()``
            whose result has an ``index``.
    """
    labels = getattr(simulator, "scenario_labels", None)
    return None if labels is None else int(labels().index)
