"""Takeovers as they are kept: what a coach notes of each, in a file and from a session."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any

from haim_torchrl.data.session import Session
from haim_torchrl.evaluation.recording import Recordable

TAKEOVERS_FILE = "takeovers.jsonl"
"""Name of the file in a run's folder."""
ENOUGH = 5
"""Takeovers below which nothing is said."""
LATE = 0.5
"""A takeover by risk is late if harm was less than this away [s]; measured, a shield that takes
over as soon as harm is foreseen is never late, and one that waits for 0.8 s mostly is."""
LATE_SHARE = 0.3
"""Share of late takeovers from which on they should begin earlier."""
OFTEN = 0.3
"""Share of mentor-driven steps above which the agent hardly drives by itself."""
FEW_RISKS = 0.3
"""Share of onsets by risk below which most takeovers were not needed; measured, 0.67 of a shield's
onsets are still seen as such a step later."""
LONG = 5.0
"""Median length [s] above which takeovers are long; measured, short ones at real risk taught
most."""
ADVICE = {
    "take over earlier": "many takeovers begin when harm is near, or after a collision: take over "
    "as soon as the danger shows",
    "let it explore": "the agent hardly drives, and few takeovers begin at a foreseen collision or "
    "departure: let it make its small mistakes",
    "shorter": "hand back as soon as the danger is over: what follows is learned from the agent's "
    "own driving",
    "good": "go on like this",
}
"""Hints, from the most to the least urgent, and what they mean."""


class TakeoverError(ValueError):
    """Takeovers that cannot be read; the message says why."""


@dataclass(frozen=True)
class Takeover:
    """One takeover; None stands for what is not known.

    Attributes:
        step: Steps that the run had driven when it began.
        length: Its length in steps.
        distance: Euclidean distance of the agent's and the mentor's action in its first step, in
            units of the action.
        scenario: Seed of the scenario.
        x, y: Position after its first step [m], as in
            :class:`~haim_torchrl.evaluation.recording.Snapshot`.
        along: Arc length on the route after its first step [m].
        block: Type of the block there.
        risk: Whether the agent's action was foreseen to end in a collision or off the road.
        time_to_harm: How soon [s], if so.
        collisions: Those that the agent caused between the takeover before and this one, which
            nobody prevented.
    """

    step: int
    length: int
    distance: float
    scenario: int | None = None
    x: float | None = None
    y: float | None = None
    along: float | None = None
    block: str | None = None
    risk: bool | None = None
    time_to_harm: float | None = None
    collisions: int | None = None

    @property
    def late(self) -> bool | None:
        """Whether it began late: after a collision, or with harm less than :data:`LATE` away."""
        if self.collisions:
            return True
        if self.risk is None:
            return None
        return self.time_to_harm is not None and self.time_to_harm < LATE


def place(simulator: Any) -> dict[str, Any]:
    """Where the vehicle is, as far as the simulator tells.

    Args:
        simulator: The unwrapped simulator. One that can be recorded tells the position; one with
            ``road.route_s`` and ``scenario.blocks``, as the X+1+N world has, arc length and block.

    Returns:
        The entries ``x``, ``y``, ``along`` and ``block`` of a :class:`Takeover`.
    """
    found: dict[str, Any] = {}
    if isinstance(simulator, Recordable):
        x, y = simulator.snapshot().vehicle[:2]
        found.update(x=round(float(x), 2), y=round(float(y), 2))
    arc_lengths = getattr(getattr(simulator, "road", None), "route_s", None)
    if arc_lengths is not None:
        along = float(arc_lengths[0])
        blocks = getattr(getattr(simulator, "scenario", None), "blocks", ())
        kinds = (kind for kind, start, end in blocks if start <= along < end)
        found.update(along=round(along, 2), block=next(kinds, None))
    return found


def append_takeover(path: str | os.PathLike[str], takeover: Takeover) -> None:
    """Add a line to a file of takeovers, which is made with its folder if it does not exist."""
    file = Path(path)
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(asdict(takeover)) + "\n")


def read_takeovers(path: str | os.PathLike[str]) -> list[Takeover]:
    """Read a file of takeovers.

    Where a run went on from a checkpoint, the takeovers after it, whose steps were driven again,
    are left out, and so is a last line that was cut.

    Raises:
        TakeoverError: If it is missing, or a line is none of a takeover.
    """
    file = Path(path)
    if not file.is_file():
        raise TakeoverError(f"takeovers {file} do not exist; a run with a coach writes them")
    kept: list[Takeover] = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(keepends=True), 1):
        if not line.endswith("\n"):
            break
        try:
            takeover = Takeover(**json.loads(line))
        except (ValueError, TypeError) as error:
            raise TakeoverError(
                f"line {number} of {file} is no takeover; use the file as a coach wrote it"
            ) from error
        while kept and kept[-1].step >= takeover.step:
            kept.pop()
        kept.append(takeover)
    return kept


def takeovers_of(session: Session) -> list[Takeover]:
    """The takeovers of a recorded session, of which risk and place are not known."""
    found: list[Takeover] = []
    step = 0
    for episode in session.episodes:
        driving = False
        for entry in episode.steps:
            if entry.intervention and (entry.takeover_start or not driving):
                distance = math.dist(entry.action_agent, entry.action_mentor)
                found.append(Takeover(step, 0, distance, entry.scenario))
            if entry.intervention:
                last = found[-1]
                found[-1] = Takeover(last.step, last.length + 1, last.distance, last.scenario)
            driving = entry.intervention
            step += 1
    return found


def share(flags: Sequence[bool | None]) -> float | None:
    """Share of true flags among those that are known; None if none is."""
    known = [flag for flag in flags if flag is not None]
    return fmean(known) if known else None


def hint(takeovers: Sequence[Takeover], rate: float, time_step: float = 0.1) -> str:
    """What would make these takeovers better, in a few words; see :data:`ADVICE`.

    Empty if it is not known why they began: then they cannot be called good.

    Args:
        takeovers: Takeovers, at least one.
        rate: Share of mentor-driven steps.
        time_step: Duration of a step [s].
    """
    late = share([takeover.late for takeover in takeovers])
    risk = share([takeover.risk for takeover in takeovers])
    if late is not None and late >= LATE_SHARE:
        return "take over earlier"
    if rate > OFTEN and risk is not None and risk < FEW_RISKS:
        return "let it explore"
    if median(takeover.length for takeover in takeovers) * time_step > LONG:
        return "shorter"
    return "" if risk is None else "good"
