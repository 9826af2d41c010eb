"""A town: its lanes, what is drawn of them, and where one drives and where not."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np

from haim_torchrl.envs.carla.frames import Pose, points_to_recording, pose_of
from haim_torchrl.envs.carla.map.lanes import LaneKey, TownLane, key_of, town_lanes
from haim_torchrl.envs.carla.map.route import Route
from haim_torchrl.envs.carla.package import carla_package
from haim_torchrl.envs.path import Array, Path
from haim_torchrl.envs.semantic import RoadLayers, band
from haim_torchrl.evaluation.recording import RoadLine

PIECE = 16
"""Samples of a lane in one polygon of its surface."""


class Town:
    """What is known of a town from its map alone.

    Args:
        town_map: a ``carla.Map``: of a server, or made from OpenDRIVE without one.

    Attributes:
        lanes: its lanes for driving.
    """

    def __init__(self, town_map: Any) -> None:
        self._map = town_map
        self.lanes: dict[LaneKey, TownLane] = town_lanes(town_map)

    @cached_property
    def surfaces(self) -> list[Array]:
        """What may be driven on, as polygons [P, 2] in the frame of recordings."""
        return [
            points_to_recording(
                np.concatenate([left[k : k + PIECE + 1], right[k : k + PIECE + 1][::-1]])
            )
            for lane in self.lanes.values()
            for left, right in [(lane.edge(-1.0), lane.edge(1.0))]
            for k in range(0, len(left) - 1, PIECE)
        ]

    @cached_property
    def lines(self) -> list[RoadLine]:
        """Edges of the road and the markings between lanes; there are none in junctions."""
        return [
            RoadLine(points_to_recording(lane.edge(side)), edge=side > 0 and lane.outer)
            for lane in self.lanes.values()
            if not lane.junction
            for side in (-1.0, 1.0)
        ]

    def layers(self, route: Route) -> RoadLayers:
        """What the semantic image shows of the town and of a route."""
        path = route.path
        points = points_to_recording(np.stack([path.x, path.y], axis=1))
        return RoadLayers(
            self.surfaces, [line.points for line in self.lines], band(points, route.lane_width)
        )

    def height(self, x: float, y: float) -> float:
        """Height of the road nearest to a point [m]."""
        return float(self._map.get_waypoint(_location(x, y)).transform.location.z)

    def is_drivable(self, x: float, y: float) -> bool:
        """Whether a point [m] lies on a lane for driving."""
        return self._map.get_waypoint(_location(x, y), project_to_road=False) is not None

    def places(self, spacing: float) -> list[Pose]:
        """Poses in the middle of the lanes outside of junctions, `spacing` [m] apart."""
        step = max(round(spacing), 1)
        return [
            (*lane.points[k].tolist(), float(lane.heading[k]))
            for lane in self.lanes.values()
            if not lane.junction
            for k in range(step // 2, len(lane.points) - 1, step)
        ]

    def way_ahead(
        self, pose: Pose, prefer: Iterable[LaneKey] = (), reach: float = 70.0
    ) -> Path | None:
        """The lane that a vehicle drives on, and where it leads.

        Args:
            pose: the vehicle.
            prefer: lanes to take where the way forks; the first of the fork otherwise.
            reach: how far ahead to look [m].

        Returns:
            The middle of its lane; None where it stands across, or on no lane.
        """
        x, y, heading = pose
        waypoint = self._map.get_waypoint(_location(x, y), project_to_road=False)
        key = None if waypoint is None else key_of(waypoint)
        if key not in self.lanes or np.cos(heading - pose_of(waypoint.transform)[2]) < 0.5:
            return None
        wanted = set(prefer)
        lane = self.lanes[key]
        start = int(np.argmin(np.hypot(*(lane.points - (x, y)).T)))
        pieces, length = [lane.points[max(start - 2, 0) :]], lane.length - start
        while length < reach and lane.follow:
            nexts = [key for key in lane.follow if key in wanted] or list(lane.follow)
            lane = self.lanes[nexts[0]]
            pieces.append(lane.points)
            length += lane.length
        points = np.concatenate(pieces)[: int(reach) + 5]
        if np.hypot(*(points[-1] - points[0])) < 2.0:
            return None
        return Path.through(points[:, 0], points[:, 1])


def _location(x: float, y: float) -> Any:
    return carla_package().Location(x=float(x), y=float(y))
