"""What one driven episode leaves behind: plain arrays, for metrics and pictures.

A simulator takes part by offering the three small methods of :class:`Recordable`. Nothing here
knows which simulator that is, so every picture of :mod:`haim_torchrl.evaluation.pictures` works for
any.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BOX_FIELDS = ("x", "y", "heading", "length", "width")
"""Columns of a box array: centre in m, heading in rad (counter-clockwise from +x), sizes in m."""


def _boxes() -> Array:
    return np.zeros((0, len(BOX_FIELDS)))


@dataclass(frozen=True)
class Snapshot:
    """The scene at one instant.

    Attributes:
        time: Time since the start of the episode, in s.
        vehicle: Box of the automated vehicle, ``[5]`` as in :data:`BOX_FIELDS`.
        speed: Its speed, in m/s.
        acceleration: Its acceleration measured over the last step, in m/s^2.
        followers: Boxes of the N followers, nearest first, ``[N, 5]``.
        follower_speeds: Their speeds, ``[N]``, in m/s.
        follower_accelerations: Their accelerations over the last step, ``[N]``, in m/s^2.
        follower_gaps: Bumper-to-bumper gaps to the predecessor, ``[N]``, in m; follower 0 follows
            the automated vehicle.
        traffic: Boxes of the other vehicles, ``[M, 5]``; M may change from step to step.
        obstacles: Boxes of obstacles, moving or not, ``[K, 5]``.
        distance: Distance driven by the automated vehicle since the start, in m.
        vehicle_length: Length of a follower in m, for turning gaps into positions.
    """

    time: float
    vehicle: Array
    speed: float
    acceleration: float
    followers: Array = field(default_factory=_boxes)
    follower_speeds: Array = field(default_factory=lambda: np.zeros(0))
    follower_accelerations: Array = field(default_factory=lambda: np.zeros(0))
    follower_gaps: Array = field(default_factory=lambda: np.zeros(0))
    traffic: Array = field(default_factory=_boxes)
    obstacles: Array = field(default_factory=_boxes)
    distance: float = 0.0
    vehicle_length: float = 5.0


@dataclass(frozen=True)
class RoadLine:
    """One line painted on the road or bounding it.

    Attributes:
        points: Points along the line, ``[P, 2]``, in m.
        edge: True for the edge of the road, False for a marking between lanes.
        route: True for the centre line of the way to the destination.
    """

    points: Array
    edge: bool = True
    route: bool = False


@dataclass(frozen=True)
class ScenarioLabels:
    """What a scenario consists of, to split results by it.

    Attributes:
        index: The scenario's number, i.e. the seed that generates it.
        blocks: Block types on the route in driving order, e.g. ``("straight", "roundabout")``.
        obstacles: Number of obstacles on the road.
    """

    index: int
    blocks: tuple[str, ...] = ()
    obstacles: int = 0


@runtime_checkable
class Recordable(Protocol):
    """What a simulator offers so that its episodes can be recorded and drawn."""

    def snapshot(self) -> Snapshot:
        """The scene now."""
        ...

    def road_polylines(self) -> list[RoadLine]:
        """The lines of the present road network; constant within an episode."""
        ...

    def scenario_labels(self) -> ScenarioLabels:
        """Number, block types and obstacles of the present scenario."""
        ...


@dataclass
class Episode:
    """A recorded episode: one :class:`Snapshot` per step and the road under them.

    Attributes:
        labels: What the scenario consists of.
        road: Lines of the road.
        snapshots: Scenes, the one after the reset first.
        interventions: Whether the mentor drove in step k, i.e. between snapshots k and k + 1.
        outcome: How it ended, in a word, e.g. ``"success"``.
    """

    labels: ScenarioLabels
    road: list[RoadLine]
    snapshots: list[Snapshot] = field(default_factory=list)
    interventions: list[bool] = field(default_factory=list)
    outcome: str = ""

    def __len__(self) -> int:
        """Number of steps driven."""
        return max(len(self.snapshots) - 1, 0)

    @property
    def times(self) -> Array:
        """Times of the snapshots, ``[T]``, in s."""
        return np.array([s.time for s in self.snapshots])

    @property
    def trail(self) -> Array:
        """Path of the automated vehicle, ``[T, 2]``, in m."""
        return np.array([s.vehicle[:2] for s in self.snapshots]).reshape(-1, 2)

    def speeds(self) -> Array:
        """Speeds of the vehicle (column 0) and its followers, ``[T, 1 + N]``, in m/s."""
        return np.array([[s.speed, *s.follower_speeds] for s in self.snapshots])

    def accelerations(self) -> Array:
        """Accelerations, columns as in :meth:`speeds`, ``[T, 1 + N]``, in m/s^2."""
        return np.array([[s.acceleration, *s.follower_accelerations] for s in self.snapshots])

    def positions(self) -> Array:
        """Positions along the driven path, columns as in :meth:`speeds`, ``[T, 1 + N]``, in m.

        A follower's position is its predecessor's less the gap and one vehicle length.
        """
        rows = []
        for snapshot in self.snapshots:
            steps = np.asarray(snapshot.follower_gaps) + snapshot.vehicle_length
            rows.append(snapshot.distance - np.concatenate(([0.0], np.cumsum(steps))))
        return np.array(rows)


def record_start(simulator: Recordable) -> Episode:
    """Begin the recording of the episode that ``simulator`` was just reset to."""
    return Episode(
        labels=simulator.scenario_labels(),
        road=list(simulator.road_polylines()),
        snapshots=[simulator.snapshot()],
    )
