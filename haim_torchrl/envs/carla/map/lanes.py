"""The drivable lanes of a town: their shape, and how they lead on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from haim_torchrl.envs.carla.frames import pose_of
from haim_torchrl.envs.carla.package import carla_package
from haim_torchrl.envs.path import Array

SPACING = 1.0
"""Distance of the waypoints that a lane is drawn through [m]."""

LaneKey = tuple[int, int, int]
"""Road, section and lane in the town's OpenDRIVE."""


@dataclass(frozen=True)
class TownLane:
    """One lane of one road, in its driving direction.

    Attributes:
        key: its name.
        points: its middle, [K, 2], up to where the next lane begins [m, y to the right].
        heading: its direction there [rad, clockwise], [K].
        width: its width there [m], [K].
        junction: whether it crosses a junction.
        outer: whether it is the rightmost lane that may be driven on.
        follow: the lanes that it leads to.
    """

    key: LaneKey
    points: Array
    heading: Array
    width: Array
    junction: bool
    outer: bool
    follow: tuple[LaneKey, ...]

    @property
    def length(self) -> float:
        """Its length [m]."""
        return float(np.hypot(*np.diff(self.points, axis=0).T).sum())

    def edge(self, side: float) -> Array:
        """An edge, [K, 2]: the right one for 1, the left one for -1."""
        right = np.stack([-np.sin(self.heading), np.cos(self.heading)], axis=1)
        return self.points + side * self.width[:, None] / 2 * right


def key_of(waypoint: Any) -> LaneKey:
    """The lane of a ``carla.Waypoint``."""
    return waypoint.road_id, waypoint.section_id, waypoint.lane_id


def town_lanes(town_map: Any) -> dict[LaneKey, TownLane]:
    """All lanes for driving of a ``carla.Map``, in the order of their keys."""
    entries: dict[LaneKey, Any] = {}
    follow: dict[LaneKey, dict[LaneKey, Any]] = {}
    for entry, successor in town_map.get_topology():
        for waypoint in (entry, successor):
            entries.setdefault(key_of(waypoint), waypoint)
        follow.setdefault(key_of(entry), {})[key_of(successor)] = successor
    return {key: _lane(key, entries[key], follow.get(key, {})) for key in sorted(entries)}


def _lane(key: LaneKey, entry: Any, follow: dict[LaneKey, Any]) -> TownLane:
    waypoints = [entry, *entry.next_until_lane_end(SPACING)]
    waypoints += [follow[next_key] for next_key in sorted(follow)][:1]
    x, y, heading = np.array([pose_of(waypoint.transform) for waypoint in waypoints]).T
    width = np.array([waypoint.lane_width for waypoint in waypoints])
    if follow:  # the end of this lane, not the width of the next
        width[-1] = width[-2]
    keep = np.concatenate([[True], np.hypot(np.diff(x), np.diff(y)) > 1e-3])
    neighbour = entry.get_right_lane()
    driving = carla_package().LaneType.Driving
    driven = neighbour is not None and neighbour.lane_type == driving
    return TownLane(
        key,
        np.stack([x, y], axis=1)[keep],
        heading[keep],
        width[keep],
        bool(entry.is_junction),
        not driven,
        tuple(sorted(follow)),
    )
