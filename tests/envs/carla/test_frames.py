"""CARLA's frame, that of paths and that of recordings, against the client package's own vectors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.envs.carla.frames import (
    centre_of,
    origin_of,
    points_to_recording,
    pose_of,
    to_recording,
    transform_of,
    wrapped,
)
from haim_torchrl.envs.path import Path

carla = pytest.importorskip("carla")
coordinates = st.floats(-500.0, 500.0)
angles = st.floats(-math.pi, math.pi)


def test_yaw_is_in_degrees_and_clockwise():
    """Facing +x, +y is on the right; a quarter to the right is yaw 90, which faces +y."""
    east = carla.Transform(carla.Location(), carla.Rotation(yaw=0.0))
    assert east.get_right_vector().y == pytest.approx(1.0)
    south = carla.Transform(carla.Location(x=1.0, y=2.0, z=3.0), carla.Rotation(yaw=90.0))
    assert south.get_forward_vector().y == pytest.approx(1.0)
    assert pose_of(south) == pytest.approx((1.0, 2.0, math.pi / 2))


@given(coordinates, coordinates, angles)
@settings(deadline=None)  # the first one compiles
def test_offsets_to_the_right_are_carlas_right(x, y, heading):
    transform = transform_of((x, y, heading), 1.0)
    right, ahead = transform.get_right_vector(), transform.get_forward_vector()
    path = Path.through(x + np.arange(5.0) * ahead.x, y + np.arange(5.0) * ahead.y)
    assert path.project((x + 2 * right.x, y + 2 * right.y))[1] == pytest.approx(2.0, abs=1e-3)


@given(coordinates, coordinates, angles)
def test_a_pose_there_and_back(x, y, heading):
    back = pose_of(transform_of((x, y, heading)))
    assert back[:2] == pytest.approx((x, y), abs=1e-3)
    assert math.cos(back[2] - heading) == pytest.approx(1.0, abs=1e-9)


@given(coordinates, coordinates, angles, st.floats(-1.0, 1.0), st.floats(-0.5, 0.5))
def test_a_box_is_put_where_it_is_read(x, y, heading, ahead, right):
    box = carla.BoundingBox(carla.Location(x=ahead, y=right), carla.Vector3D(2.0, 1.0, 1.0))
    back = centre_of(origin_of((x, y, heading), box, 0.0), box)
    assert back[:2] == pytest.approx((x, y), abs=1e-3)
    assert (box.location.x, box.location.y) == pytest.approx((ahead, right))


def test_the_middle_of_a_box_by_hand():
    """One metre ahead of an origin that faces +y."""
    box = carla.BoundingBox(carla.Location(x=1.0, y=0.5), carla.Vector3D(2.0, 1.0, 1.0))
    centre = centre_of(transform_of((10.0, 20.0, math.pi / 2)), box)
    assert centre == pytest.approx((9.5, 21.0, math.pi / 2), abs=1e-5)


def test_recordings_have_the_left_where_opendrive_has_it():
    box = np.array([10.0, 3.0, math.pi / 2, 4.8, 1.9])
    np.testing.assert_allclose(to_recording(box), [10.0, -3.0, -math.pi / 2, 4.8, 1.9])
    np.testing.assert_allclose(points_to_recording(np.array([[1.0, 2.0]])), [[1.0, -2.0]])


def test_maps_turn_opendrives_left_into_minus_y(town_map):
    """Road A runs along OpenDRIVE's +x; its right lane is at y = -2 there and y = +2 in CARLA."""
    lane = town_map.get_waypoint_xodr(1, -1, 50.0).transform
    assert (lane.location.x, lane.location.y) == pytest.approx((50.0, 2.0))
    assert math.cos(pose_of(lane)[2]) == pytest.approx(1.0)
    against = town_map.get_waypoint_xodr(1, 1, 50.0).transform
    assert against.location.y == pytest.approx(-2.0)
    assert math.cos(pose_of(against)[2]) == pytest.approx(-1.0)


@given(st.floats(-50.0, 50.0))
def test_wrapped_angles_point_the_same_way(angle):
    assert -math.pi < wrapped(angle) <= math.pi
    assert math.cos(wrapped(angle) - angle) == pytest.approx(1.0)
