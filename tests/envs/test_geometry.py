"""Neighbours, predictions, overlaps and rays, against values by hand and plain searches."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.envs.geometry import (
    COLUMNS,
    HALF_LENGTH,
    HALF_WIDTH,
    HEADING,
    D,
    S,
    X,
    Y,
    along,
    cast_rays,
    locate,
    neighbours,
    overlaps,
    predict,
    touching,
)
from haim_torchrl.envs.path import Piece, arc, draw

LINE = draw([Piece(200.0)])
BEND = draw([Piece(20.0), arc(30.0, math.pi / 2), Piece(20.0)])
boxes = st.tuples(
    st.floats(-12, 12), st.floats(-12, 12), st.floats(-4, 4), st.floats(0.4, 3), st.floats(0.4, 2)
)


def rays(others, x=0.0, y=0.0, heading=0.0, speed=0.0, count=240, reach=50.0):
    table = np.array(others).reshape(-1, COLUMNS)
    return cast_rays(x, y, heading, speed, table, count, reach)


def corners(x, y, heading, length, width):
    cos, sin = math.cos(heading), math.sin(heading)
    around = [(length, width), (length, -width), (-length, -width), (-length, width)]
    return [(x + cos * a - sin * b, y + sin * a + cos * b) for a, b in around]


def edges(box):
    points = corners(*box)
    return list(zip(points, points[1:] + points[:1]))


def along_ray(x, y, ux, uy, a, b):
    """Distance at which a ray meets the segment a-b, or infinity."""
    ex, ey = b[0] - a[0], b[1] - a[1]
    cross = ux * ey - uy * ex
    if abs(cross) < 1e-12:
        return math.inf
    t = ((a[0] - x) * ey - (a[1] - y) * ex) / cross
    share = ((a[0] - x) * uy - (a[1] - y) * ux) / cross
    return t if t >= 0 and -1e-12 <= share <= 1 + 1e-12 else math.inf


def contains(box, point):
    x, y, heading, length, width = box
    dx, dy = point[0] - x, point[1] - y
    cos, sin = math.cos(heading), math.sin(heading)
    return abs(cos * dx + sin * dy) <= length and abs(-sin * dx + cos * dy) <= width


def meet(box, other):
    """Whether two boxes overlap: an edge crosses another one, or one lies inside the other."""
    if contains(box, other[:2]) or contains(other, box[:2]):
        return True
    for a, b in edges(box):
        size = math.dist(a, b)
        ux, uy = (b[0] - a[0]) / size, (b[1] - a[1]) / size
        if any(along_ray(*a, ux, uy, c, d) <= size for c, d in edges(other)):
            return True
    return False


# Rays.
def test_a_vehicle_ahead_is_seen_at_its_rear(body):
    distances, rates = rays([body(22.5, 0.0)], speed=10.0)
    assert distances[0] == pytest.approx(20.0)
    assert rates[0] == pytest.approx(-10.0)  # coming nearer at the own speed
    # Its rear is 2 m wide: the outermost ray that hits it lies at atan(1 / 20) = 1.9 rays.
    assert np.flatnonzero(distances < 50.0).tolist() == [0, 1, 239]
    assert distances[1] == pytest.approx(20.0 / math.cos(math.radians(1.5)))
    assert rates[1] == pytest.approx(-10.0 * math.cos(math.radians(1.5)))


def test_a_vehicle_behind_is_seen_at_its_front(body):
    distances, rates = rays([body(-12.5, 0.0, speed=13.0)], speed=10.0)
    assert distances[120] == pytest.approx(10.0)
    assert rates[120] == pytest.approx(-3.0)


def test_rays_go_round_clockwise(body):
    right, _ = rays([body(0.0, 4.0)])
    assert right[60] == pytest.approx(3.0)
    assert right[180] == 50.0
    left, rates = rays([body(0.0, -4.0, speed=7.0)], speed=7.0)
    assert left[180] == pytest.approx(3.0)
    assert rates == pytest.approx(np.zeros(240))  # side by side at the same speed


def test_rays_turn_with_the_vehicle(body):
    ahead = body(22.5, 0.0)
    straight = rays([ahead], speed=5.0)
    ahead[[X, Y, HEADING]] = 100.0, 50.0 + 22.5, math.pi / 2
    turned = rays([ahead], x=100.0, y=50.0, heading=math.pi / 2, speed=5.0)
    assert turned[0] == pytest.approx(straight[0])
    assert turned[1] == pytest.approx(straight[1])


def test_crossing_traffic_moves_along_the_ray_only_by_its_part(body):
    _, rates = rays([body(20.0, 0.0, heading=math.pi / 2, speed=8.0)])
    assert rates[0] == pytest.approx(0.0)
    step = math.radians(1.5)
    assert rates[1] == pytest.approx(8.0 * math.sin(step))


def test_the_nearer_hides_the_farther(body):
    near, far = body(12.5, 0.0), body(32.5, 0.0, speed=9.0)
    for order in ([near, far], [far, near]):
        distances, rates = rays(order, speed=1.0)
        assert distances[0] == pytest.approx(10.0)
        assert rates[0] == pytest.approx(-1.0)


def test_nothing_is_seen_out_of_reach(body):
    distances, rates = rays([body(60.0, 0.0)], speed=10.0)
    assert (distances == 50.0).all()
    assert (rates == 0.0).all()
    distances, _ = rays([])
    assert (distances == 50.0).all()


@given(st.lists(boxes, min_size=1, max_size=4), st.floats(-3, 3))
@settings(max_examples=60, deadline=None)
def test_rays_agree_with_a_search_over_all_edges(placed, heading):
    placed = [box for box in placed if not contains(box, (0.0, 0.0))]
    rows = np.zeros((len(placed), COLUMNS))
    for row, box in zip(rows, placed):
        row[[X, Y, HEADING, HALF_LENGTH, HALF_WIDTH]] = box
    distances, _ = rays(rows, heading=heading, count=24, reach=15.0)
    for k, found in enumerate(distances):
        angle = heading + 2 * math.pi * k / 24
        ux, uy = math.cos(angle), math.sin(angle)
        hits = [along_ray(0, 0, ux, uy, a, b) for box in placed for a, b in edges(box)]
        expected = min([15.0, *hits])
        if abs(found - expected) > 1e-6:  # a ray that just grazes a corner may be either
            points = [point for box in placed for point in corners(*box)]
            assert min(abs(ux * py - uy * px) for px, py in points) < 1e-6


# Overlaps.
@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ((4.9, 0.0, 0.0, 2.5, 1.0), True),
        ((5.1, 0.0, 0.0, 2.5, 1.0), False),
        ((0.0, 1.9, 0.0, 2.5, 1.0), True),
        ((0.0, 2.1, 0.0, 2.5, 1.0), False),
        ((3.4, 0.0, math.pi / 2, 2.5, 1.0), True),  # across: reaches 1 m towards the first
        ((3.6, 0.0, math.pi / 2, 2.5, 1.0), False),
        ((0.0, 0.0, 1.0, 0.2, 0.2), True),  # inside
        # A square on its corner, whose tip at 4 - sqrt(2) stays clear of 2.5 by 0.09 m.
        ((4.0, 0.0, math.pi / 4, 1.0, 1.0), False),
        ((3.8, 0.0, math.pi / 4, 1.0, 1.0), True),
    ],
)
def test_overlaps_by_hand(other, expected):
    assert overlaps(0.0, 0.0, 0.0, 2.5, 1.0, *other) is expected
    assert overlaps(*other, 0.0, 0.0, 0.0, 2.5, 1.0) is expected


@given(boxes, boxes)
@settings(max_examples=400, deadline=None)
def test_overlaps_agree_with_a_search_over_all_edges(box, other):
    def grown(by):
        return (*box[:3], box[3] + by, box[4] + by)

    if meet(grown(1e-6), other) == meet(grown(-1e-6), other):  # else they just touch
        assert overlaps(*box, *other) == meet(box, other)


def test_touching_names_the_rows(body):
    bodies = np.array([body(0, 0), body(4.9, 0), body(0, 8), body(-3, 1.5), body(70, 0)])
    assert touching(bodies).tolist() == [1, 3]


# Neighbours and positions.
def test_neighbours_by_hand(body):
    bodies = np.array(
        [
            body(50.0, 0.0),
            body(90.0, 0.0),
            body(70.0, 0.5),  # the leader
            body(55.0, 4.0),  # in the next lane
            body(30.0, -1.0),  # the follower
            body(20.0, 0.0),
        ]
    )
    path = LINE.x, LINE.y, LINE.heading
    assert neighbours(0, bodies, *path, 1.4) == (2, 4)
    assert neighbours(4, bodies, *path, 1.4) == (0, 5)
    assert neighbours(1, bodies, *path, 1.4) == (-1, 2)
    beside = LINE.shifted(4.0)
    assert neighbours(0, bodies, beside.x, beside.y, beside.heading, 1.4) == (3, -1)


def test_a_wide_thing_reaches_into_the_lane(body):
    narrow, wide = body(70.0, 2.0), body(70.0, 2.0, size=(5.0, 3.6))
    path = LINE.x, LINE.y, LINE.heading
    # Counts as in the way within 1.4 m + half of its width - 1 m: 1.4 m and 2.2 m.
    assert neighbours(0, np.array([body(50.0, 0.0), narrow]), *path, 1.4) == (-1, -1)
    assert neighbours(0, np.array([body(50.0, 0.0), wide]), *path, 1.4) == (1, -1)


def test_neighbours_beyond_80_m_do_not_count(body):
    path = LINE.x, LINE.y, LINE.heading
    near, far = (np.array([body(50.0, 0.0), body(x, 0.0)]) for x in (129.0, 131.0))
    assert neighbours(0, near, *path, 1.4) == (1, -1)
    assert neighbours(0, far, *path, 1.4) == (-1, -1)


def test_positions_on_paths(body):
    bodies = np.array([body(10, 1, path=0), body(5, -3, path=1), body(9, 9, path=-1)])
    xs = np.concatenate([LINE.x, LINE.x])
    ys = np.concatenate([LINE.y, LINE.y - 2.0])
    headings = np.concatenate([LINE.heading, LINE.heading])
    n = len(LINE.x)
    locate(bodies, xs, ys, headings, np.array([0, n, 2 * n]))
    assert bodies[:, [S, D]] == pytest.approx(np.array([[10, 1], [5, -1], [0, 0]]))
    s, d = along(bodies, LINE.x, LINE.y, LINE.heading)
    assert s == pytest.approx([10, 5, 9])
    assert d == pytest.approx([1, -3, 9])


# Predictions.
def predicted(row, path=LINE, steps=20, dt=0.2):
    starts = np.array([0, len(path.x)])
    return predict(row[None], path.x, path.y, path.heading, starts, steps, dt)[:, 0]


def test_others_keep_their_speed(body):
    poses = predicted(body(10.0, 0.0, speed=8.0, acceleration=2.0, path=0, s=10.0))
    assert poses[:, 0] == pytest.approx(10 + 8 * 0.2 * np.arange(1, 21))
    assert poses[:, 1:] == pytest.approx(np.zeros((20, 2)))


def test_others_brake_on_as_they_do_now_down_to_a_standstill(body):
    poses = predicted(body(10.0, 0.0, speed=8.0, acceleration=-4.0, path=0, s=10.0))
    assert poses[4, 0] == pytest.approx(10 + 8 * 1 - 2 * 1**2)  # after 1 s
    assert poses[9:, 0] == pytest.approx(np.full(11, 18.0))  # 8² / (2 · 4) = 8 m, after 2 s


def test_others_come_back_to_the_middle_of_their_path_within_two_seconds(body):
    poses = predicted(body(10.0, 1.0, speed=8.0, path=0, s=10.0, d=1.0))
    assert poses[4, 1] == pytest.approx(0.5)
    assert poses[9:, 1] == pytest.approx(np.zeros(11))


def test_others_follow_their_path_round_a_bend(body):
    row = body(15.0, 0.0, speed=10.0, path=0, s=15.0)
    x, y, heading = predicted(row, BEND)[-1]
    assert BEND.project((x, y)) == pytest.approx((55.0, 0.0), abs=0.02)
    assert heading == pytest.approx(35.0 / 30.0, abs=0.02)


def test_what_has_no_path_goes_straight_on(body):
    x, y, heading = predicted(body(1.0, 2.0, heading=math.pi / 2, speed=3.0))[-1]
    assert (x, y, heading) == pytest.approx((1.0, 14.0, math.pi / 2))
