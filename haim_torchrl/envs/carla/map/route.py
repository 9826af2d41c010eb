"""Ways through a town: the shortest from lane to lane."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from haim_torchrl.envs.carla.map.lanes import LaneKey, TownLane
from haim_torchrl.envs.path import Path


@dataclass(frozen=True)
class Route:
    """A way through a town.

    Attributes:
        path: its middle.
        keys: the lanes that it follows.
        blocks: what they are, in driving order: ``straight``, ``curve`` or ``junction``; what is
            alike and follows each other is named once.
        lane_width: the width of the narrowest [m].
    """

    path: Path
    keys: tuple[LaneKey, ...]
    blocks: tuple[str, ...]
    lane_width: float


def shortest_ways(
    lanes: Mapping[LaneKey, TownLane], start: LaneKey
) -> dict[LaneKey, tuple[float, tuple[LaneKey, ...]]]:
    """The shortest way from the beginning of a lane to every lane that can be reached.

    Lanes are not changed on the way, only followed (Dijkstra's algorithm).

    Returns:
        For each lane the distance to its beginning [m], and the lanes from `start` to it.
    """
    found: dict[LaneKey, tuple[float, tuple[LaneKey, ...]]] = {}
    queue: list[tuple[float, tuple[LaneKey, ...]]] = [(0.0, (start,))]
    while queue:
        distance, way = heapq.heappop(queue)
        last = way[-1]
        if last in found:
            continue
        found[last] = distance, way
        for key in lanes[last].follow:
            if key in lanes and key not in found:
                heapq.heappush(queue, (distance + lanes[last].length, (*way, key)))
    return found


def draw_route(
    lanes: Mapping[LaneKey, TownLane],
    rng: np.random.Generator,
    run_up: float,
    length: tuple[float, float],
) -> Route:
    """Draw a start and a destination, and take the shortest way.

    Args:
        lanes: those of the town.
        rng: source of randomness; the same state gives the same route.
        run_up: length ahead of the start, on which the followers stand [m].
        length: least and greatest length from the start to the destination [m].

    Raises:
        ValueError: the town has no way of that length.
    """
    least, most = run_up + length[0], run_up + length[1]
    origins = [key for key, lane in lanes.items() if not lane.junction]
    for k in rng.permutation(len(origins)).tolist():
        origin = origins[k]
        offset = int(rng.integers(max(int(lanes[origin].length), 1)))
        ways = [
            way
            for key, (distance, way) in shortest_ways(lanes, origin).items()
            if not lanes[key].junction
            and distance - offset < most
            and distance - offset + lanes[key].length >= least + 1.0
        ]
        if ways:
            return _route(lanes, ways[int(rng.integers(len(ways)))], offset, most)
    raise ValueError(
        f"route_length: the town has no way of {least:.0f} m, the followers' {run_up:.0f} m "
        "included; use shorter routes"
    )


def _route(
    lanes: Mapping[LaneKey, TownLane], way: tuple[LaneKey, ...], offset: int, most: float
) -> Route:
    points = np.concatenate([lanes[key].points for key in way])
    path = Path.through(points[:, 0], points[:, 1]).part(offset, offset + most)
    blocks: list[str] = []
    for key in way:
        kind = _kind(lanes[key])
        if not blocks or blocks[-1] != kind:
            blocks.append(kind)
    width = min(float(lanes[key].width.min()) for key in way)
    return Route(path, way, tuple(blocks), width)


def _kind(lane: TownLane) -> str:
    if lane.junction:
        return "junction"
    turn = np.abs(np.diff(np.unwrap(lane.heading))).sum()
    return "curve" if turn > np.pi / 6 else "straight"
