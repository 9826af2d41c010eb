"""What is sent draws the same road with fewer points, and is JSON whatever the simulator says."""

from __future__ import annotations

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.human import Frame, Scene
from haim_torchrl.human.browser.encoding import TOLERANCE, encode_frame, encode_scene

NAN, INF = float("nan"), float("inf")


def sent(points: np.ndarray) -> np.ndarray:
    scene = json.loads(encode_scene(Scene(0, ScenarioLabels(0), [RoadLine(points)])))
    return np.array(scene["road"][0]["points"]).reshape(-1, 2)


def distance(point: np.ndarray, line: np.ndarray) -> float:
    """From a point to a line of at least two points."""
    start, chord = line[:-1], np.diff(line, axis=0)
    square = np.maximum((chord**2).sum(1), 1e-12)
    share = np.clip(((point - start) * chord).sum(1) / square, 0.0, 1.0)
    return float(np.hypot(*(start + share[:, None] * chord - point).T).min())


def test_a_straight_line_needs_two_points_and_a_corner_a_third() -> None:
    straight = np.stack([np.arange(0.0, 100.0, 0.5), np.full(200, 3.0)], 1)
    assert sent(straight).tolist() == [[0.0, 3.0], [99.5, 3.0]]
    corner = np.concatenate([straight, [[99.5, 50.0]]])
    assert sent(corner).tolist() == [[0.0, 3.0], [99.5, 3.0], [99.5, 50.0]]


COORDINATES = st.floats(-1000.0, 1000.0, allow_subnormal=False)


@given(points=st.lists(st.tuples(COORDINATES, COORDINATES), min_size=2, max_size=20))
def test_no_point_is_far_from_the_line_that_is_sent(points: list[tuple[float, float]]) -> None:
    given_points = np.array(points)
    line = sent(given_points)
    assert np.abs(line[[0, -1]] - given_points[[0, -1]]).max() <= 0.0051
    assert max(distance(point, line) for point in given_points) <= TOLERANCE + 0.0072


def test_what_is_not_finite_is_left_open() -> None:
    boxes = np.array([[1.0, 2.0, 0.5, 5.0, 2.0], [NAN, 2.0, 0.5, 5.0, 2.0]])
    snapshot = Snapshot(
        NAN, boxes[1], INF, -INF, boxes, np.array([7.5, NAN]), np.zeros(2), np.array([INF, 3.0])
    )
    frame = json.loads(encode_frame(Frame(0, 1, snapshot, cost=NAN, action=(NAN, 0.5))))
    assert frame["vehicle"] is None and frame["speed"] is None and frame["time"] is None
    assert frame["followers"] == [[1.0, 2.0, 0.5, 5.0, 2.0], None]
    assert frame["follower_speeds"] == [7.5, None] and frame["follower_gaps"] == [None, 3.0]
    assert frame["cost"] is None and frame["action"] == [None, 0.5]
    road = [RoadLine(np.array([[0.0, 0.0], [NAN, 1.0], [2.0, 0.0]])), RoadLine(np.zeros((0, 2)))]
    scene = json.loads(encode_scene(Scene(0, ScenarioLabels(0), road)))
    assert [line["points"] for line in scene["road"]] == [[[0.0, 0.0], [2.0, 0.0]], []]
