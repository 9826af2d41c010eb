"""MetaDrive's lanes as paths. MetaDrive's y axis points left, that of paths to the right."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from haim_torchrl.envs.carriageway import Carriageway
from haim_torchrl.envs.path import Array, Path

SAMPLING = 2.0
"""Distance of the points taken of a lane [m]; paths interpolate between them."""


def points(lane: Any, start: float, end: float, lateral: float = 0.0) -> Array:
    """Points of a lane between two arc lengths [m], at an offset [m]; [P, 2], y to the right."""
    count = max(int(np.ceil((end - start) / SAMPLING)), 1) + 1
    return np.array(
        [np.asarray(lane.position(s, lateral), dtype=float) for s in np.linspace(start, end, count)]
    ) * [1.0, -1.0]


def lane_middle(lane: Any, start: float, end: float) -> Path:
    """The middle of a lane between two arc lengths [m]."""
    return Path.through(*points(lane, start, end).T)


def chain(lanes: Sequence[Any]) -> Path:
    """The middle of lanes that follow each other."""
    return Path.through(*np.concatenate([points(lane, 0.0, lane.length) for lane in lanes]).T)


def carriageway(graph: Any, checkpoints: Sequence[str], lanes: int, width: float) -> Carriageway:
    """The carriageway along a route.

    Every road of it has the same `lanes` lanes; at a ramp there is one more on the right, which
    leads nowhere and is left out.

    Args:
        graph: MetaDrive's roads: lanes by start and end node.
        checkpoints: nodes of the route.
        lanes: number of lanes.
        width: of each [m].
    """
    middles = []
    for start, end in pairwise(checkpoints):
        road = graph[start][end]
        left, right = road[0], road[lanes - 1]
        share = np.linspace(0.0, 1.0, max(int(np.ceil(left.length / SAMPLING)), 1) + 1)
        for t in share:
            outer = np.asarray(left.position(t * left.length, 0.0), dtype=float)
            inner = np.asarray(right.position(t * right.length, 0.0), dtype=float)
            middles.append((outer + inner) / 2)
    xy = np.array(middles) * [1.0, -1.0]
    return Carriageway(Path.through(*xy.T), lanes, width)


def way_of(vehicle: Any, target: Any, graph: Any, roads: int = 3) -> Path:
    """Where a vehicle that keeps to its lane will drive.

    Args:
        vehicle: a vehicle of MetaDrive.
        target: the lane that it steers for.
        graph: MetaDrive's roads.
        roads: number of roads to look ahead, the present one included.
    """
    lanes, (start, end, number) = [target], target.index
    nodes = list(vehicle.navigation.checkpoints) if vehicle.navigation is not None else []
    for at in range(len(nodes) - 1):
        if (nodes[at], nodes[at + 1]) == (start, end):
            for a, b in zip(nodes[at + 1 :], nodes[at + 2 : at + 1 + roads]):
                road = graph[a][b]
                lanes.append(road[min(number, len(road) - 1)])
            break
    return chain(lanes)
