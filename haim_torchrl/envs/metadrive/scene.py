"""MetaDrive's scene for recordings and pictures, in their frame: y to the left, as MetaDrive's."""

from __future__ import annotations

from typing import Any

import numpy as np
from metadrive.constants import PGLineType

from haim_torchrl.envs.carriageway import Carriageway
from haim_torchrl.envs.geometry import HALF_LENGTH, HALF_WIDTH, HEADING, PATH, X, Y
from haim_torchrl.envs.metadrive.road import MetaDriveRoad
from haim_torchrl.envs.metadrive.route import points
from haim_torchrl.envs.semantic import RoadLayers, band
from haim_torchrl.evaluation.recording import RoadLine, Snapshot


def take_snapshot(
    road: MetaDriveRoad, time: float, acceleration: float, distance: float
) -> Snapshot:
    """The scene now.

    Args:
        road: the scene.
        time: since the start of the episode [s].
        acceleration: the AV's over the last step [m/s²].
        distance: driven by it so far [m].
    """
    platoon = road.platoon
    boxes = road.bodies[:, [X, Y, HEADING, HALF_LENGTH, HALF_WIDTH]] * [1, -1, -1, 2, 2]
    first = 1 + road.followers
    moving = road.others[:, PATH] >= 0
    return Snapshot(
        time=time,
        vehicle=boxes[0],
        speed=road.av.speed,
        acceleration=acceleration,
        followers=boxes[1:first],
        follower_speeds=platoon.speeds.copy(),
        follower_accelerations=platoon.accelerations.copy(),
        follower_gaps=platoon.gaps.copy(),
        traffic=boxes[first:][moving],
        obstacles=boxes[first:][~moving],
        distance=distance,
        vehicle_length=road.av.model.length,
    )


def lane_layers(graph: Any, scenario: Carriageway) -> RoadLayers:
    """Surfaces, lines and the route's carriageway, for images.

    Args:
        graph: MetaDrive's roads: lanes by start and end node.
        scenario: the AV's carriageway.
    """
    flip = [1.0, -1.0]
    surfaces = [
        part
        for ends in graph.values()
        for lanes in ends.values()
        for lane in lanes
        for part in band(points(lane, 0.0, lane.length) * flip, lane.width)
    ]
    route = scenario.route
    return RoadLayers(
        surfaces=surfaces,
        lines=[line.points for line in lane_lines(graph, scenario) if not line.route],
        route=band(np.stack([route.x, -route.y], 1), 2 * scenario.half_width),
    )


def lane_lines(graph: Any, scenario: Carriageway) -> list[RoadLine]:
    """The lines of every road as MetaDrive paints them, and the route.

    Args:
        graph: MetaDrive's roads: lanes by start and end node.
        scenario: the AV's carriageway.
    """
    lines = []
    for ends in graph.values():
        for lanes in ends.values():
            for k, lane in enumerate(lanes):
                # A lane has the line on its left if it is the first, and always that on its right.
                for side, kind in zip((-1, 1), lane.line_types, strict=True):
                    if kind == PGLineType.NONE or (side < 0 and k > 0):
                        continue
                    line = points(lane, 0.0, lane.length, side * lane.width / 2) * [1.0, -1.0]
                    lines.append(RoadLine(line, edge=kind != PGLineType.BROKEN))
    route = scenario.route
    lines.append(RoadLine(np.stack([route.x, -route.y], 1), edge=False, route=True))
    return lines
