"""The seven block types: where they lead, and how their side roads meet the route."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from haim_torchrl.envs.blocks import BLOCKS, LANE_WIDTH, Block, SideRoad, lane_offset
from haim_torchrl.envs.path import Path, Piece, draw

BEFORE, AFTER = 100.0, 60.0


def place(kind: str, seed: int, lanes: int) -> tuple[Block, Path, list[SideRoad]]:
    """A block between two straights, with its side roads."""
    block = BLOCKS[kind](np.random.default_rng(seed), lanes)
    route = draw([Piece(BEFORE), *block.pieces, Piece(AFTER)])
    return block, route, block.sides(route, BEFORE, lanes)


def samples(kind: str, count: int = 12) -> list[tuple[int, Block, Path, list[SideRoad]]]:
    return [
        (lanes, *place(kind, seed, lanes))
        for seed, lanes in itertools.product(range(count), (2, 3))
    ]


def turns(kind: str) -> set[int]:
    """By how many quarter turns the route changes its direction, over many draws."""
    return {
        round(sum(p.length * p.curvature for p in block.pieces) / (math.pi / 2))
        for _, block, _, _ in samples(kind, 40)
    }


def test_lanes_are_numbered_from_the_left():
    assert [lane_offset(k, 3) for k in range(3)] == [-4.0, 0.0, 4.0]
    assert [lane_offset(k, 2) for k in range(2)] == [-2.0, 2.0]


def test_all_the_papers_blocks_are_there():
    assert set(BLOCKS) == {
        *("straight", "curve", "ramp", "fork", "t_junction", "intersection", "roundabout")
    }
    for kind in BLOCKS:
        assert all(block.kind == kind and block.length > 45 for _, block, _, _ in samples(kind, 3))


def test_a_seed_gives_one_block():
    for kind in BLOCKS:
        (a, first, _), (b, second, _) = place(kind, 3, 2), place(kind, 3, 2)
        assert a.pieces == b.pieces
        assert np.array_equal(first.x, second.x)


def test_where_blocks_lead():
    assert turns("straight") == turns("ramp") == {0}
    assert turns("t_junction") == turns("intersection") == turns("roundabout") == {-1, 0, 1}
    for _, block, _, _ in samples("curve", 40):
        angle = sum(piece.length * piece.curvature for piece in block.pieces)
        assert math.radians(40) <= abs(angle) <= math.radians(90)
        assert all(abs(p.curvature) <= 1 / 35 for p in block.pieces)


def test_a_car_gets_round_every_bend():
    """The AV's smallest turning radius is 9.5 m; the innermost lane must be wider."""
    for kind in BLOCKS:
        for lanes, block, _, _ in samples(kind):
            for piece in block.pieces:
                if piece.curvature:
                    assert 1 / abs(piece.curvature) - lane_offset(lanes - 1, lanes) > 11.0


def test_obstacles_stand_on_open_road_only():
    open_road = {kind for kind in BLOCKS if place(kind, 0, 2)[0].open_road}
    assert open_road == {"straight", "curve"}
    assert all(not place(kind, 0, 2)[2] for kind in open_road)


@pytest.mark.parametrize("kind", ["ramp", "fork", "t_junction", "intersection", "roundabout"])
def test_junctions_have_other_traffic(kind):
    assert all(sides for _, _, _, sides in samples(kind))


@pytest.mark.parametrize("kind", list(BLOCKS))
def test_who_waits_at_the_line_stands_clear_of_the_route(kind):
    for lanes, block, route, sides in samples(kind):
        for side in sides:
            if side.give_way_at is None:
                assert side.leaves_from is not None
                continue
            assert side.conflict is not None
            nose = side.path.at(side.give_way_at)
            s, d = route.project(nose[:2])
            assert abs(d) > lanes * LANE_WIDTH / 2 or not BEFORE <= s <= BEFORE + block.length
            assert BEFORE <= side.conflict[0] < side.conflict[1] <= BEFORE + block.length


@pytest.mark.parametrize("kind", list(BLOCKS))
def test_side_roads_meet_the_route_only_where_they_say(kind):
    """Before the line a side road stays off the carriageway, behind it the paths do meet."""
    for lanes, _, route, sides in samples(kind):
        half = lanes * LANE_WIDTH / 2
        for side in sides:
            if side.give_way_at is None or side.conflict is None:
                continue
            path = side.path
            places = [route.project(p) for p in zip(path.x, path.y)]
            meets = [s for s, d in places if abs(d) < half and s > side.conflict[0] - 5]
            assert meets
            assert min(meets) < side.conflict[1] + 5


def test_a_ramp_ends_in_the_right_lane():
    for lanes, _, route, (side,) in samples("ramp"):
        far = side.path.at(108.0)
        assert route.project(far[:2])[1] == pytest.approx(lane_offset(lanes - 1, lanes), abs=0.02)
        start = route.project(side.path.at(0.0)[:2])[1]
        assert start > lanes * LANE_WIDTH / 2 + 2.0


def test_who_leaves_at_a_fork_crosses_nobody():
    for lanes, _, route, (side,) in samples("fork"):
        d = [route.project(p)[1] for p in zip(side.path.x[::5], side.path.y[::5])]
        outside = 1 if side.leaves_from == lanes - 1 else -1
        assert side.leaves_from in (0, lanes - 1)
        own = outside * lane_offset(lanes - 1, lanes)
        assert min(outside * value for value in d) > outside * own - 0.2
        assert outside * d[-1] > 8.0  # really gone


def test_paths_of_side_roads_do_not_jump():
    for kind in BLOCKS:
        for _, _, _, sides in samples(kind):
            for side in sides:
                bend = np.abs(np.diff(side.path.heading))
                assert bend.max() < 0.2, kind


@pytest.mark.parametrize("kind", ["t_junction", "intersection"])
def test_who_joins_drives_on_in_one_lane(kind):
    joined = 0
    for lanes, _, route, sides in samples(kind):
        for side in sides:
            places = [route.project(p) for p in zip(side.path.x, side.path.y)]
            if side.conflict is None or abs(places[-1][1]) > lanes * LANE_WIDTH / 2:
                continue
            joined += 1
            after = [d for s, d in places if side.conflict[1] + 2 < s < route.length]
            assert min(abs(after[0] - lane_offset(k, lanes)) for k in (0, lanes - 1)) < 0.05
            assert max(after) - min(after) < 0.05
    assert joined > 5


def test_who_leaves_does_so_at_the_junction():
    for kind in ("fork", "intersection"):
        for seed in range(12):
            rng = np.random.default_rng(seed)
            first, block = BLOCKS["curve"](rng, 3), BLOCKS[kind](rng, 3)
            start = BEFORE + first.length
            route = draw([Piece(BEFORE), *first.pieces, *block.pieces, Piece(AFTER)])
            for side in block.sides(route, start, 3):
                if side.leaves_from is None:
                    continue
                s, d = route.project(side.path.at(side.surface[0])[:2])
                assert s == pytest.approx(start + 35.0, abs=2.0)
                assert d == pytest.approx(lane_offset(side.leaves_from, 3), abs=0.1)
