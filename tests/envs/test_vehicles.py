"""The AV's dynamics by hand, and the traffic's driving on curved lanes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.envs.lanes import PathLane, comfortable_speeds
from haim_torchrl.envs.path import Piece, arc, draw
from haim_torchrl.envs.scenario import Spawn
from haim_torchrl.envs.vehicles import AutomatedVehicle, TrafficVehicle, command


def av(speed: float = 10.0) -> AutomatedVehicle:
    return AutomatedVehicle(None, np.zeros(2), 0.0, speed)


# Actions.
@pytest.mark.parametrize(
    ("pedal", "acceleration"),
    [(-1.0, -8.0), (-0.5, -4.0), (0.0, 0.0), (0.5, 2.0), (1.0, 4.0), (3.0, 4.0), (-2.0, -8.0)],
)
def test_the_pedal_is_mapped_piecewise(pedal, acceleration):
    assert command(np.array([pedal, 0.0])) == {"acceleration": acceleration, "steering": 0.0}


@pytest.mark.parametrize(("wheel", "angle"), [(-1.0, -0.5), (0.4, 0.2), (1.0, 0.5), (7.0, 0.5)])
def test_the_wheel_is_mapped_linearly(wheel, angle):
    assert command(np.array([0.0, wheel], dtype=np.float32))["steering"] == pytest.approx(angle)


@pytest.mark.parametrize("action", [(math.nan, 0.0), (0.0, math.inf)])
def test_an_action_that_is_no_number_is_refused(action):
    with pytest.raises(ValueError, match="action: must be two finite numbers, got"):
        command(np.array(action))


# The AV.
def test_the_av_drives_straight():
    vehicle = av(10.0)
    vehicle.drive(np.array([1.0, 0.0]))
    vehicle.step(0.1)
    assert vehicle.position.tolist() == [1.0, 0.0]
    assert vehicle.speed == pytest.approx(10.4)
    vehicle.step(0.1)
    assert vehicle.position[0] == pytest.approx(2.04)


def test_the_av_turns_like_a_bicycle():
    vehicle = av(10.0)
    vehicle.drive(np.array([0.0, 1.0]))
    vehicle.step(0.1)
    slip = math.atan(math.tan(0.5) / 2)
    assert vehicle.heading == pytest.approx(10.0 * math.sin(slip) / 2.5 * 0.1)
    assert vehicle.position == pytest.approx([math.cos(slip), math.sin(slip)])


def test_the_smallest_circle_of_the_av():
    """At full lock the centre of the vehicle goes round on a radius of 9.5 m."""
    vehicle = av(2.0)
    vehicle.drive(np.array([0.0, 1.0]))
    places = []
    for _ in range(400):
        vehicle.step(0.1)
        places.append(vehicle.position)
    x, y = np.array(places).T
    assert np.ptp(x) / 2 == pytest.approx(9.5, abs=0.1)
    assert np.ptp(y) / 2 == pytest.approx(9.5, abs=0.1)


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=60))
@settings(max_examples=50, deadline=None)
def test_the_speed_stays_between_standstill_and_15(actions):
    vehicle = av(7.0)
    for action in actions:
        vehicle.drive(np.array(action))
        vehicle.step(0.1)
        assert 0.0 <= vehicle.speed <= 15.0


def test_the_av_can_brake_harder_than_the_disturbance_threshold():
    vehicle = av(10.0)
    vehicle.drive(np.array([-1.0, 0.0]))
    vehicle.step(0.1)
    assert (vehicle.speed - 10.0) / 0.1 == pytest.approx(-8.0)


# Traffic.
def test_comfortable_speeds_by_hand():
    path = draw([Piece(100.0), arc(40.0, 1.5), Piece(50.0)])
    speeds = comfortable_speeds(path, comfort=2.5, braking=1.5)
    assert speeds[125] == pytest.approx(math.sqrt(2.5 * 40.0), rel=0.01)  # 10 m/s in the bend
    assert speeds[80] == pytest.approx(math.sqrt(speeds[90] ** 2 + 2 * 1.5 * 10), rel=1e-6)
    assert speeds[-1] > 40.0  # a straight road asks for nothing


def test_traffic_steers_as_highway_env_does(empty_road):
    road = empty_road({"blocks": {"curve": 1.0}}).road
    lane = road.lanes[0]
    rng = np.random.default_rng(0)
    for _ in range(100):
        vehicle = TrafficVehicle(road, road.indices[0], Spawn(200.0, 8.0, 0, None, 0.0))
        x, y, heading = lane.path.at(rng.uniform(150, 300), rng.normal(0, 3.0))
        vehicle.position = np.array([x, y])
        vehicle.heading, vehicle.speed = heading + rng.normal(0, 0.5), abs(rng.normal(4.0, 4.0))
        expected = IDMVehicle.steering_control(vehicle, road.indices[0])
        assert vehicle.steering_control(road.indices[0]) == expected


def test_traffic_keeps_its_lane_and_slows_down_for_bends(empty_road):
    env = empty_road({"blocks": {"curve": 1.0}, "lanes": (3,)})
    road = env.road
    spawn = Spawn(150.0, 14.0, 2, None, 0.0)
    vehicle = TrafficVehicle(road, road.indices[2], spawn)
    vehicle.enable_lane_change = False
    road.vehicles.append(vehicle)
    road.refresh()
    offsets, too_fast, slowest = [], [], 99.0
    while vehicle in road.vehicles:
        env.step(np.array([0.0, 0.0]))
        s, d = vehicle.lane.path.project(vehicle.position)
        offsets.append(abs(d))
        too_fast.append(vehicle.speed - vehicle.lane.speed_at(s))
        slowest = min(slowest, vehicle.speed)
    assert len(offsets) > 100
    assert max(offsets) < 0.5
    assert max(too_fast) < 1.5
    assert slowest < 12.0


def test_a_lane_is_what_highway_env_expects():
    lane = PathLane(draw([Piece(50.0)], (0.0, 10.0, 0.0)))
    assert lane.length == 50.0
    assert lane.position(20.0, 1.0).tolist() == pytest.approx([20.0, 11.0])
    assert lane.heading_at(20.0) == 0.0
    assert lane.local_coordinates(np.array([20.0, 11.0])) == pytest.approx((20.0, 1.0))
    assert lane.width_at(3.0) == 4.0
    assert lane.on_lane(np.array([20.0, 11.9]))
    assert not lane.on_lane(np.array([20.0, 12.1]))
    assert lane.is_reachable_from(np.array([20.0, 14.0]))
    assert not lane.after_end(np.array([20.0, 10.0]))
    assert lane.after_end(np.array([53.0, 10.0]))
