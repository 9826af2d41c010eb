"""What happens to the AV in an episode: contacts, progress and outcome."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from haim_torchrl.envs.carla.frames import Pose
from haim_torchrl.envs.path import Path

ARRIVAL = 8.0
"""The destination is this far before the end of the route [m]."""
RELEASE = 5
"""A contact has ended when nothing was reported of it for this many frames."""
SEAM = 0.2
"""Maps have gaps of up to this between lanes side by side [m]."""
BEHIND, AHEAD = 30.0, 120.0
"""How much of the route around the AV is looked at [m]; elsewhere it may cross itself."""


Other = TypeVar("Other")


class Contacts(Generic[Other]):
    """Turns what a collision sensor reports, frame by frame, into events.

    CARLA reports a contact in each frame in which it lasts, and a lasting one may be missing from
    some of them. One contact is one event.
    """

    def __init__(self) -> None:
        self._last: dict[Other, int] = {}

    def update(self, reports: Iterable[tuple[int, Other]]) -> list[Other]:
        """Take in reports, each a frame and who was hit.

        Returns:
            Whom a new contact began with, each once.
        """
        new = []
        for frame, other in sorted(reports, key=lambda report: report[0]):
            last = self._last.get(other)
            if last is None or frame - last > RELEASE:
                new.append(other)
            self._last[other] = max(frame, last or frame)
        return new


class Progress:
    """Where the AV is on its route.

    Args:
        path: the route.
        start: arc length at the start [m].

    Attributes:
        s, d: arc length and offset [m, positive to the right].
        error: heading relative to the route's [rad].
    """

    def __init__(self, path: Path, start: float) -> None:
        self._path, self._start = path, start
        self.s, self.d, self.error = start, 0.0, 0.0

    def window(self) -> tuple[Path, float]:
        """The part of the route around the AV, and the arc length at which it begins [m]."""
        low = float(max(round(self.s - BEHIND), 0))
        return self._path.part(low, self.s + AHEAD), low

    def update(self, pose: Pose) -> float:
        """Follow the AV to its new pose.

        Returns:
            How far it came along the route [m].
        """
        part, low = self.window()
        before = self.s
        s, self.d = part.project(pose[:2])
        self.s = s + low
        self.error = pose[2] - self._path.at(self.s)[2]
        return self.s - before

    @property
    def share(self) -> float:
        """Share of the way that is done, in [0, 1]."""
        span = self._path.length - ARRIVAL - self._start
        return float(np.clip((self.s - self._start) / span, 0.0, 1.0))

    @property
    def arrived(self) -> bool:
        """Whether the destination is reached."""
        return self.s >= self._path.length - ARRIVAL


@dataclass(frozen=True)
class Events:
    """What happened in a step; the names are those of the info entries.

    Attributes:
        crash: whether a collision began.
        out_of_road: whether the AV is on no lane for driving, or too far from its route.
        wrong_way: whether it heads against the route.
        success: whether it arrived, and none of the above.
        cost: number of collisions that began.
    """

    crash: bool = False
    out_of_road: bool = False
    wrong_way: bool = False
    success: bool = False
    cost: float = 0.0


def judge(
    progress: Progress, collisions: int, drivable: bool, lane_width: float, off_route: float
) -> Events:
    """What happened in a step.

    Args:
        progress: where the AV is.
        collisions: how many began.
        drivable: whether the map has a lane for driving there; on the route's own lane that does
            not matter, because maps have gaps between lanes that meet.
        lane_width: width of the route's lane [m].
        off_route: largest distance to the route's middle [m].
    """
    beside = abs(progress.d) > lane_width / 2 + SEAM
    out = (beside and not drivable) or abs(progress.d) > off_route
    wrong = bool(np.cos(progress.error) < 0.0)
    crash = collisions > 0
    good = progress.arrived and not (out or wrong or crash)
    return Events(crash, out, wrong, good, float(collisions))
