"""Road blocks: the pieces of a route and the side roads that other traffic uses.

A route is a chain of blocks (straight, curve, on-ramp merge, fork, T-junction, intersection,
roundabout: the paper's list). A block adds a piece of carriageway to the route and may add side
roads: ramps, arms of a junction, the rest of a roundabout's ring. Carriageways are one-way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from haim_torchrl.envs.path import Path, Piece, arc, draw

LANE_WIDTH = 4.0
"""Width of every lane [m]."""
Pose = tuple[float, float, float]
Sides = Callable[[Path, float, int], "list[SideRoad]"]


@dataclass(frozen=True)
class SideRoad:
    """A path that other traffic drives, and where it gives way.

    Attributes:
        path: centre of the single lane that the traffic follows, to its end.
        surface: the part of the path that needs its own pavement (arc lengths [m]).
        give_way_at: arc length [m] on `path` where the driver waits for a gap; None: no waiting.
        conflict: arc lengths [m] on the route between which the two paths meet.
        leaves_from: lane of the route that the path leaves (route traffic may take it), or None
            for traffic that comes from outside the route.
    """

    path: Path
    surface: tuple[float, float]
    give_way_at: float | None = None
    conflict: tuple[float, float] | None = None
    leaves_from: int | None = None


@dataclass(frozen=True)
class Block:
    """One block of the route.

    Attributes:
        kind: name of the block type.
        pieces: lines and arcs of the carriageway's centre line.
        sides: builds the side roads from the whole route, the arc length at which the block
            starts and the number of lanes.
        open_road: whether obstacles may stand here (no junction in the way).
    """

    kind: str
    pieces: tuple[Piece, ...]
    sides: Sides = field(default=lambda route, start, lanes: [])
    open_road: bool = False

    @property
    def length(self) -> float:
        """Arc length of the block [m]."""
        return sum(piece.length for piece in self.pieces)


def lane_offset(lane: int, lanes: int) -> float:
    """Lateral offset [m] of a lane's centre from the carriageway's centre (lane 0 is leftmost)."""
    return (lane - (lanes - 1) / 2) * LANE_WIDTH


def straight(rng: np.random.Generator, lanes: int) -> Block:
    """A straight road of 70 to 110 m."""
    return Block("straight", (Piece(rng.uniform(70, 110)),), open_road=True)


def curve(rng: np.random.Generator, lanes: int) -> Block:
    """A bend by 40 to 90 degrees with a radius of 35 to 70 m."""
    angle = rng.choice([-1, 1]) * rng.uniform(np.radians(40), np.radians(90))
    bend = arc(rng.uniform(35, 70), angle)
    return Block("curve", (Piece(10), bend, Piece(15)), open_road=True)


def ramp(rng: np.random.Generator, lanes: int) -> Block:
    """A straight road that an on-ramp joins from the right over an acceleration lane."""
    length = 130.0

    def sides(route: Path, start: float, lanes: int) -> list[SideRoad]:
        own = lane_offset(lanes - 1, lanes)
        knots = [0.0, 45.0, 75.0, 105.0]
        offsets = [own + 18.0, own + LANE_WIDTH, own + LANE_WIDTH, own]
        s = np.arange(0.0, route.length - start)
        d = _smooth(s, knots, offsets)
        points = [route.at(start + si, di) for si, di in zip(s, d, strict=True)]
        path = Path.through(np.array([p[0] for p in points]), np.array([p[1] for p in points]))
        return [SideRoad(path, (0.0, 108.0), 68.0, (start + 60.0, start + 110.0))]

    return Block("ramp", (Piece(length),), sides)


def fork(rng: np.random.Generator, lanes: int) -> Block:
    """A road that splits in two; the route takes either branch."""
    side = int(rng.choice([-1, 1]))
    turn = arc(60.0, side * rng.uniform(np.radians(30), np.radians(45)))
    turns_off = bool(rng.random() < 0.5)
    route_pieces = (Piece(35), turn, Piece(20)) if turns_off else (Piece(90),)
    other = (Piece(70),) if turns_off else (turn, Piece(30))
    # Traffic for the other branch leaves from the outermost lane on its side, so that it crosses
    # nobody's path.
    leaves_right = (side < 0) if turns_off else (side > 0)

    def sides(route: Path, start: float, lanes: int) -> list[SideRoad]:
        lane = lanes - 1 if leaves_right else 0
        return [_leaving(route, start + 35.0, lane, lanes, other)]

    return Block("fork", route_pieces, sides)


def t_junction(rng: np.random.Generator, lanes: int) -> Block:
    """Three arms: the route turns at the end of the stem, or passes by a stem that joins it."""
    if rng.random() < 1 / 3:
        return Block("t_junction", (Piece(100),), _stem_from_the_right)
    return _turning("t_junction", rng, lanes, goes_on=False)


def intersection(rng: np.random.Generator, lanes: int) -> Block:
    """Four arms: the route goes straight across, or turns left or right."""
    if rng.random() < 2 / 3:
        return _turning("intersection", rng, lanes, goes_on=True)
    directions = [-1, 1] if rng.random() < 0.5 else [int(rng.choice([-1, 1]))]

    def sides(route: Path, start: float, lanes: int) -> list[SideRoad]:
        return [_crossing(route, start + 50.0 + shift * 4.0, shift, lanes) for shift in directions]

    return Block("intersection", (Piece(100),), sides)


def roundabout(rng: np.random.Generator, lanes: int) -> Block:
    """A roundabout: the route leaves at the first, second or third exit."""
    ring, radius, entry = 26.0, 18.0, np.radians(50)
    turn = {"right": -np.pi / 2, "straight": 0.0, "left": np.pi / 2}
    around = 2 * entry + turn[str(rng.choice(list(turn)))]
    pieces = (Piece(25), arc(radius, entry), arc(ring, -around), arc(radius, entry), Piece(25))

    def sides(route: Path, start: float, lanes: int) -> list[SideRoad]:
        entered = start + 25.0 + radius * entry
        x, y, heading = route.at(entered)
        centre = (x + ring * np.sin(heading), y - ring * np.cos(heading))
        r = ring + lane_offset(0, lanes)  # the innermost lane
        # The circulating driver comes from the arm on the left, passes the entry and goes on round.
        before, after = np.radians(75), np.radians(100)
        first = heading + before
        begin = (centre[0] - r * np.sin(first), centre[1] + r * np.cos(first), first)
        approach = draw([Piece(30), arc(20.0, np.radians(45))])
        on_ring = draw([arc(r, -(before + after)), arc(18.0, np.radians(50)), Piece(60)], begin)
        path = _arriving(approach, begin).then(on_ring)
        ring_start = approach.length
        at_entry = ring_start + r * before
        return [
            SideRoad(
                path,
                (0.0, path.length),
                at_entry - 14.0,
                (entered - 8.0, entered + r * min(after, around)),
            )
        ]

    return Block("roundabout", pieces, sides)


BLOCKS: dict[str, Callable[[np.random.Generator, int], Block]] = {
    "straight": straight,
    "curve": curve,
    "ramp": ramp,
    "fork": fork,
    "t_junction": t_junction,
    "intersection": intersection,
    "roundabout": roundabout,
}
"""The block types by name; each makes a random block for a number of lanes."""


def _turning(kind: str, rng: np.random.Generator, lanes: int, goes_on: bool) -> Block:
    side = int(rng.choice([-1, 1]))
    radius = 14.0 + lanes * LANE_WIDTH / 2
    before = 35.0

    def sides(route: Path, start: float, lanes: int) -> list[SideRoad]:
        end = start + before + radius * np.pi / 2
        lane = lanes - 1 if side < 0 else 0  # on the outside of the turn
        roads = [_joining(route, start + before, end, lane, lanes, radius)]
        if goes_on:
            roads.append(_leaving(route, start + before, lane, lanes, (Piece(90),)))
        return roads

    return Block(kind, (Piece(before), arc(radius, side * np.pi / 2), Piece(35)), sides)


def _joining(
    route: Path, turn: float, end: float, lane: int, lanes: int, radius: float
) -> SideRoad:
    """Traffic that comes straight on where the route turns into its road."""
    offset = lane_offset(lane, lanes)
    x, y, heading = route.at(end, offset)
    run = 60.0 + radius
    start = (x - run * np.cos(heading), y - run * np.sin(heading), heading)
    path = draw([Piece(run)], start).then(route.part(end, route.length).shifted(offset))
    return SideRoad(
        path, (0.0, run), run - radius - lanes * LANE_WIDTH / 2 - 5.0, (turn + 2.0, end + 8.0)
    )


def _leaving(route: Path, at: float, lane: int, lanes: int, pieces: Sequence[Piece]) -> SideRoad:
    """Traffic of the route that takes another branch from one of its outer lanes."""
    offset = lane_offset(lane, lanes)
    before = route.part(0, at).shifted(offset)
    pose = (before.x[-1], before.y[-1], before.heading[-1])
    path = before.then(draw(pieces, pose))
    return SideRoad(path, (before.length, path.length), leaves_from=lane)


def _crossing(route: Path, at: float, direction: int, lanes: int) -> SideRoad:
    """Traffic that crosses a straight part of the route; direction +1 goes to the right."""
    x, y, heading = route.at(at)
    across = heading + direction * np.pi / 2
    run = 60.0
    start = (x - run * np.cos(across), y - run * np.sin(across), across)
    half = lanes * LANE_WIDTH / 2
    path = draw([Piece(2 * run + 20)], start)
    return SideRoad(path, (0.0, path.length), run - half - 5.0, (at - 4.0, at + 4.0))


def _stem_from_the_right(route: Path, start: float, lanes: int) -> list[SideRoad]:
    radius, run = 10.0, 50.0
    offset = lane_offset(lanes - 1, lanes)
    end = start + 60.0
    x, y, heading = route.at(end, offset)
    turn = draw([Piece(run), arc(radius, np.pi / 2)])
    path = _arriving(turn, (x, y, heading)).then(route.part(end, route.length).shifted(offset))
    return [SideRoad(path, (0.0, turn.length), run - 4.0, (end - radius - 4.0, end + 10.0))]


def _arriving(path: Path, pose: Pose) -> Path:
    """The path, moved so that it ends in the pose (x [m], y [m], heading [rad])."""
    turn = pose[2] - path.heading[-1]
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = path.x - path.x[-1], path.y - path.y[-1]
    return Path(pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y, path.heading + turn)


def _smooth(s: np.ndarray, knots: Sequence[float], values: Sequence[float]) -> np.ndarray:
    """Offsets at `s` [m] that pass from one knot's value to the next along half a cosine."""
    index = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, len(knots) - 2)
    low, high = np.take(knots, index), np.take(knots, index + 1)
    share = np.clip((s - low) / (high - low), 0.0, 1.0)
    blend = (1 - np.cos(np.pi * share)) / 2
    return np.take(values, index) * (1 - blend) + np.take(values, index + 1) * blend
