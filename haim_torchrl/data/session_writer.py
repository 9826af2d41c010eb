"""Writes a session while it is driven, so that a crash costs next to nothing."""

from __future__ import annotations

import os
import threading
import time
import weakref
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from io import FileIO
from pathlib import Path
from typing import Any

from haim_torchrl import __version__
from haim_torchrl.data.session import (
    FIELDS,
    FORMAT,
    VERSION,
    SessionError,
    encode,
    read_lines,
    seal,
)

PACKAGES = ("torch", "torchrl", "tensordict", "numpy", "gymnasium", "highway-env")
SYNC_EVERY = 1.0
"""Seconds between writings to the disk itself."""


class SessionWriter:
    """Writes a session line by line.

    Each line is handed to the operating system at once, so that the end of this process, however
    sudden, loses no step. Once a second (in a thread, since disks are slow) and at the end of each
    episode all of it is forced onto the disk (``fsync``): a failure of the machine loses the last
    second.

    Args:
        path: File to write; its folder is made.
        seed: Seed of the run, for the header.
        settings: Settings of the run as text, for the header.

    Raises:
        FileExistsError: If the file exists: no session is ever overwritten.

    Examples:
        >>> import tempfile
        >>> from haim_torchrl.data import read_session
        >>> path = tempfile.mkdtemp() + "/session.jsonl"
        >>> with SessionWriter(path, seed=0) as writer:
        ...     writer.begin_episode(scenario=17)
        ...     writer.add([0.1, 0.0], [0.0, 0.0], [0.1, 0.0], intervention=False)
        >>> [(step.scenario, step.action) for step in read_session(path).steps()]
        [(17, (0.1, 0.0))]
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        seed: int | None = None,
        settings: str | None = None,
    ) -> None:
        file = Path(path)
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            stream = FileIO(file, "x")
        except FileExistsError:
            raise FileExistsError(
                f"{file} holds another session, and nothing is overwritten; choose another path"
            ) from None
        self._begin(file, stream)
        self._write_entry(
            {
                "format": FORMAT,
                "version": VERSION,
                "versions": package_versions(),
                "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
                "seed": seed,
                "settings": settings,
                "fields": FIELDS,
            }
        )

    @classmethod
    def resume(cls, path: str | os.PathLike[str], steps: int) -> SessionWriter:
        """Go on with a session after its first ``steps`` steps.

        What follows them is kept beside the file, in ``<stem>.after-<steps>.jsonl``, or with a
        number if that exists (``.after-<steps>.2.jsonl``): a session of its own, whose steps keep
        their numbers. It is on the disk before the file is cut. If the steps that follow were
        damaged they are kept as they are, and cannot be read as a session.

        Args:
            path: The session.
            steps: Number of steps to keep.

        Raises:
            SessionError: If the file is missing, damaged, or holds fewer steps.
        """
        file = Path(path)
        if not file.is_file():
            raise SessionError(
                f"session {file} is gone, so that it cannot be gone on with; put it back, or "
                "start a new run"
            )
        kept, episodes, checksum, end = 0, 0, 0, 0
        for line in read_lines(file):
            if kept == steps and line.kind != "header":
                break
            if line.kind == "step":
                kept += 1
                episodes = line.entry["episode"] + 1
            checksum, end = line.checksum, line.end
        if kept < steps or end == 0:
            raise SessionError(
                f"session {file} holds {kept} steps only, and {steps} were driven before the run "
                "was saved; put the whole file back, or start a new run"
            )
        stream = FileIO(file, "r+")
        _keep_aside(file, steps, end)
        stream.truncate(end)
        stream.seek(end)
        writer = cls.__new__(cls)
        writer._begin(file, stream, checksum, kept, episodes)
        return writer

    def _begin(
        self, path: Path, stream: FileIO, checksum: int = 0, steps: int = 0, episodes: int = 0
    ) -> None:
        self.path = path
        self.steps = steps
        self.episodes = episodes
        self._stream, self._checksum = stream, checksum
        self._scenario = "null"
        self._step = -1  # no episode yet
        self._unsynced = False
        self._failure: OSError | None = None
        self._closing = threading.Event()
        threading.Thread(
            target=_keep_synced, args=(weakref.ref(self), self._closing), daemon=True
        ).start()

    def begin_episode(
        self, *, scenario: int | None = None, random_state: dict[str, Any] | None = None
    ) -> None:
        """Write that an episode begins.

        Args:
            scenario: Seed of its scenario.
            random_state: State of the simulator's generator before it was drawn.
        """
        self._scenario, self._step = encode(scenario), 0
        self._write_entry(
            {"episode": self.episodes, "scenario": scenario, "random_state": random_state}
        )
        self.episodes += 1

    def add(
        self,
        action_agent: list[float],
        action_mentor: list[float],
        action: list[float],
        *,
        intervention: bool,
        takeover_start: bool = False,
        done: bool = False,
        device_ok: bool = True,
        latency_ms: float | None = None,
        policy_version: int | float | str | None = None,
        observation: str | None = None,
    ) -> None:
        """Write one step of the present episode; see :data:`~haim_torchrl.data.session.FIELDS`.

        Raises:
            ValueError: If no episode has begun.
            OSError: If the disk refuses, now or since the last step.
        """
        if self._step < 0:
            raise ValueError("no episode has begun: call begin_episode() before add().")
        # Put together by hand, which takes a third of the time that a JSON encoder takes.
        optional = ""
        if latency_ms is not None:
            optional += f',"latency_ms":{encode(latency_ms)}'
        if policy_version is not None:
            optional += f',"policy_version":{encode(policy_version)}'
        if observation is not None:
            optional += f',"observation":"{observation}"'
        self._write(
            f'{{"episode":{self.episodes - 1},"scenario":{self._scenario},"step":{self._step},'
            f'"action_agent":{_numbers(action_agent)},"action_mentor":{_numbers(action_mentor)},'
            f'"action":{_numbers(action)},"intervention":{_FLAG[intervention]},'
            f'"takeover_start":{_FLAG[takeover_start]},"done":{_FLAG[done]},'
            f'"device_ok":{_FLAG[device_ok]},"time":{time.time():.3f}{optional}}}'
        )
        self._step += 1
        self.steps += 1
        if done:
            self.sync()

    def sync(self) -> None:
        """Force onto the disk what was written so far."""
        if self._unsynced:
            self._unsynced = False
            os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Force all of it onto the disk and close the file; closing twice does no harm."""
        if not self._closing.is_set():
            self._closing.set()
            self.sync()
            self._stream.close()

    def __enter__(self) -> SessionWriter:
        """The writer."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close."""
        self.close()

    def __del__(self) -> None:
        if "_closing" in self.__dict__:
            self.close()

    def _write_entry(self, entry: dict[str, Any]) -> None:
        self._write(encode(entry))

    def _write(self, text: str) -> None:
        if self._failure is not None:
            raise self._failure
        line, self._checksum = seal(text, self._checksum)
        if self._stream.write(line) != len(line):
            raise OSError(f"the disk of {self.path} is full: the session ends here")
        self._unsynced = True


_FLAG = {False: "false", True: "true"}


def _numbers(values: list[float]) -> str:
    text = repr(values)
    return encode(values) if "n" in text else text  # nan and inf have names of their own in JSON


def _keep_synced(writer: weakref.ref[SessionWriter], closing: threading.Event) -> None:
    """Sync once a second until the writer is closed or forgotten."""
    while not closing.wait(SYNC_EVERY):
        present = writer()
        if present is None:
            return
        try:
            present.sync()
        except (OSError, ValueError) as error:
            if not closing.is_set() and isinstance(error, OSError):
                present._failure = error
            return
        del present


def _keep_aside(file: Path, steps: int, end: int) -> None:
    """Write what stands in a session after its first ``end`` bytes to a file beside it."""
    try:
        content = _as_session(file, end)
    except SessionError:
        whole = file.read_bytes()
        content = whole[: whole.index(b"\n") + 1] + whole[end:]
    if not content:
        return
    number, aside = 2, file.with_name(f"{file.stem}.after-{steps}{file.suffix}")
    while aside.exists():
        aside = file.with_name(f"{file.stem}.after-{steps}.{number}{file.suffix}")
        number += 1
    with aside.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def _as_session(file: Path, end: int) -> bytes:
    """The steps after the first ``end`` bytes of a session as one of their own; empty for none."""
    content, checksum, steps = bytearray(), 0, 0
    begins: dict[str, Any] | None = None  # the episode, if it was not written yet
    for line in read_lines(file):
        if line.kind == "episode":
            begins = line.entry
        if line.kind == "header":
            entries = [line.entry]
        elif line.kind == "step" and line.end > end:
            entries = [line.entry] if begins is None else [begins, line.entry]
            begins, steps = None, steps + 1
        else:
            continue
        for entry in entries:
            sealed, checksum = seal(encode(entry), checksum)
            content += sealed
    return bytes(content) if steps else b""


def package_versions() -> dict[str, str]:
    """Versions of this package and of those that data depend on, by name."""
    found = {"haim_torchrl": __version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
