"""Lanes, routes and surfaces of a hand-written town, read by the client package's own map."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.envs.carla.map.lanes import town_lanes
from haim_torchrl.envs.carla.map.route import draw_route, shortest_ways
from haim_torchrl.envs.carla.map.town import Town

pytest.importorskip("carla")
A, B, C, G, M = (1, 0, -1), (2, 0, -1), (3, 0, -1), (7, 0, -1), (11, 0, -1)
AHEAD, LEFT = (101, 0, -1), (103, 0, -1)


@pytest.fixture(scope="module")
def town(town_map):
    return Town(town_map)


@pytest.fixture(scope="module")
def lanes(town):
    return town.lanes


def area(polygon) -> float:
    x, y = polygon.T
    return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2


def test_lanes_are_as_long_as_they_were_drawn(lanes):
    assert len(lanes) == 11 * 2 + 12
    assert lanes[A].length == pytest.approx(200.0)
    assert lanes[C].length == pytest.approx(32 * math.pi / 2, abs=0.1)  # the outer lane
    assert lanes[3, 0, 1].length == pytest.approx(28 * math.pi / 2, abs=0.1)
    assert lanes[LEFT].length == pytest.approx(12 * math.pi / 2, abs=0.1)
    assert lanes[104, 0, -1].length == pytest.approx(8 * math.pi / 2, abs=0.1)


def test_a_lane_is_where_it_was_drawn(lanes):
    np.testing.assert_allclose(lanes[A].points[[0, -1]], [[0.0, 2.0], [200.0, 2.0]], atol=1e-3)
    np.testing.assert_allclose(lanes[A].edge(1.0)[0], [0.0, 4.0], atol=1e-3)
    np.testing.assert_allclose(lanes[A].edge(-1.0)[0], [0.0, 0.0], atol=1e-3)
    assert not lanes[A].junction
    assert lanes[LEFT].junction
    assert lanes[A].outer  # the lane beside it is a pavement


def test_lanes_lead_on(lanes):
    assert lanes[A].follow == (AHEAD, LEFT)
    assert lanes[LEFT].follow == (M,)
    assert lanes[1, 0, 1].follow == ((10, 0, 1),)
    for lane in lanes.values():
        for key in lane.follow:
            np.testing.assert_allclose(lanes[key].points[0], lane.points[-1], atol=0.05)


def test_the_shortest_way_is_the_middle_road(lanes):
    """From A to G by the middle: 200 m, two left turns of 6π m and 140 m; round it is 600 m."""
    distance, way = shortest_ways(lanes, A)[G]
    assert distance == pytest.approx(200 + 2 * 6 * math.pi + 140, abs=0.3)
    assert way == (A, LEFT, M, (205, 0, -1), G)


def test_who_drives_against_a_is_never_sent_along_it(lanes):
    """Nobody turns round on the road: from A's oncoming lane the way to A leads round the block."""
    distance, way = shortest_ways(lanes, (1, 0, 1))[A]
    assert distance > 800.0
    assert len(way) > 5


@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_routes_are_drivable_and_as_long_as_asked(lanes, seed):
    route = draw_route(lanes, np.random.default_rng(seed), 105.0, (150.0, 300.0))
    path = route.path
    assert 255.0 <= path.length <= 405.0
    np.testing.assert_allclose(np.hypot(np.diff(path.x), np.diff(path.y)), 1.0, atol=0.05)
    assert np.abs(np.diff(np.unwrap(path.heading))).max() < 0.3  # no kink
    for one, other in pairwise(route.keys):
        assert other in lanes[one].follow
    again = draw_route(lanes, np.random.default_rng(seed), 105.0, (150.0, 300.0))
    np.testing.assert_array_equal(again.path.x, path.x)
    assert route.lane_width == pytest.approx(4.0)


def test_blocks_are_named_in_driving_order(lanes):
    names = {draw_route(lanes, np.random.default_rng(k), 100, (300, 400)).blocks for k in range(30)}
    assert ("straight", "curve", "straight", "curve", "straight") in names
    assert any("junction" in blocks for blocks in names)


def test_a_town_without_so_long_a_way_is_refused(lanes):
    with pytest.raises(ValueError, match="route_length"):
        draw_route(lanes, np.random.default_rng(0), 105.0, (5000.0, 6000.0))


@pytest.mark.parametrize(
    ("x", "y", "drivable"),
    [
        (100.0, 2.0, True),
        (100.0, 3.9, True),
        (100.0, 4.1, False),  # the pavement
        (100.0, -3.9, True),  # the oncoming lane
        (100.0, -4.1, False),
        (210.0, 0.5, True),  # the middle of the junction
        (150.0, -80.0, False),  # between the roads
    ],
)
def test_where_one_may_drive(town, x, y, drivable):
    assert town.is_drivable(x, y) == drivable


def test_surfaces_cover_what_was_drawn(town):
    """Road A has two lanes of 200 m by 4 m, on both sides of y = 0."""
    on_a = [p for p in town.surfaces if np.abs(p[:, 1]).max() < 4.1 and p[:, 0].max() < 200.1]
    on_a = [p for p in on_a if p[:, 0].min() >= -1e-6 and np.ptp(p[:, 1]) < 4.1]
    assert sum(area(polygon) for polygon in on_a) == pytest.approx(1600.0, rel=1e-3)


def test_surfaces_are_in_the_frame_of_opendrive(town):
    """The upper roads lie at y = 160 there."""
    assert max(polygon[:, 1].max() for polygon in town.surfaces) == pytest.approx(164.0, abs=0.1)
    assert min(polygon[:, 1].min() for polygon in town.surfaces) == pytest.approx(-4.0, abs=0.1)


def test_lines_are_edges_and_middle_lines(town):
    assert len(town.lines) == 11 * 2 * 2  # no lines in junctions
    edges = [line for line in town.lines if line.edge]
    assert len(edges) == 22
    right_of_a = [line for line in edges if np.allclose(line.points[0], (0.0, -4.0), atol=1e-3)]
    assert len(right_of_a) == 1


def test_the_way_ahead_takes_the_preferred_turn(town):
    pose = (190.0, 2.3, 0.05)
    straight, turn = town.way_ahead(pose), town.way_ahead(pose, [LEFT, M])
    assert straight.project((230.0, 2.0))[1] == pytest.approx(0.0, abs=0.05)
    assert turn.project((212.0, -30.0))[1] == pytest.approx(0.0, abs=0.05)
    assert straight.length >= 60.0


def test_no_way_ahead_for_who_stands_across_or_beside(town):
    assert town.way_ahead((100.0, 2.0, math.pi / 2)) is None
    assert town.way_ahead((100.0, 2.0, math.pi)) is None
    assert town.way_ahead((100.0, 30.0, 0.0)) is None


def test_a_lane_that_ends_leads_nowhere(town_map):
    """Without the turns of a junction, lanes end there."""
    lanes = {key: lane for key, lane in town_lanes(town_map).items() if not lane.junction}
    assert G not in shortest_ways(lanes, A)
