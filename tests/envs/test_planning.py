"""The look-ahead of forecasts and of the expert, by hand on a straight road."""

from __future__ import annotations

import math

import numpy as np
import pytest

from haim_torchrl.envs.path import Piece, arc, draw
from haim_torchrl.envs.planning import Manoeuvre, Margins, look_ahead, pursue

NONE = Margins(road=0.0, ahead=0.0, beside=0.0, still=0.0)


def at_speed(env, speed: float):
    env.vehicle.speed = speed
    env.road.refresh()
    return env.road


def test_time_to_collision_by_hand(empty_road, put_vehicle):
    env = empty_road()
    d = float(env.road.route_d[0])
    put_vehicle(env, 25.0, lane=env.vehicle.lane_index[2])
    road = at_speed(env, 10.0)
    ahead = look_ahead(road, Manoeuvre(then=0.0, target_d=d), NONE)
    # 20 m from bumper to bumper; poses are compared every 0.2 s.
    assert ahead.time_to_collision == pytest.approx(2.0, abs=0.21)
    assert ahead.time_to_departure == math.inf
    assert not ahead.free
    assert look_ahead(road, Manoeuvre(then=-3.0, target_d=d), NONE).free  # stops after 17.2 m
    assert not look_ahead(road, Manoeuvre(then=-2.2, target_d=d), NONE).free  # 23.2 m
    assert look_ahead(road, Manoeuvre(then=0.0, target_d=d, horizon=1.5), NONE).free


def test_margins_make_things_longer_and_wider(empty_road, put_vehicle):
    env = empty_road()
    lane = env.vehicle.lane_index[2]
    d = float(env.road.route_d[0])
    put_vehicle(env, 25.0, lane=lane)
    road = at_speed(env, 10.0)
    brake = Manoeuvre(then=-3.0, target_d=d)  # 2.8 m are left
    assert look_ahead(road, brake, Margins(0.0, 9.0, 0.0, 2.5)).free
    assert not look_ahead(road, brake, Margins(0.0, 0.0, 0.0, 4.0)).free
    put_vehicle(env, 25.0, lane=1 - lane)
    passing = Manoeuvre(then=-3.0, target_d=d)  # 2 m to the side
    assert look_ahead(env.road, passing, Margins(0.0, 0.0, 1.5, 0.0)).free


def test_a_moving_leader_is_where_it_will_be(empty_road, put_vehicle):
    env = empty_road()
    put_vehicle(env, 12.0, lane=env.vehicle.lane_index[2], speed=10.0)
    d = float(env.road.route_d[0])
    assert look_ahead(at_speed(env, 10.0), Manoeuvre(then=0.0, target_d=d), NONE).free


def test_time_to_departure_by_hand(empty_road):
    env = empty_road()
    env.vehicle.heading = math.pi / 2  # across the road
    road = at_speed(env, 10.0)
    to_edge = 4.0 - float(road.route_d[0])
    held = Manoeuvre(then=0.0, hold=3.0)
    assert look_ahead(road, held, NONE).time_to_departure == pytest.approx(to_edge / 10, abs=0.11)
    near = look_ahead(road, held, Margins(1.0, 0.0, 0.0, 0.0))
    assert near.time_to_departure == pytest.approx((to_edge - 1.0) / 10, abs=0.11)


def test_the_lateral_acceleration_of_the_first_command(empty_road):
    road = at_speed(empty_road(), 8.0)
    outlook = look_ahead(road, Manoeuvre(then=-5.0, hold=0.1, steering=0.2), NONE)
    slip = math.atan(math.tan(0.2) / 2)
    assert outlook.lateral_acceleration == pytest.approx(8.0**2 * math.sin(slip) / 2.5)
    assert look_ahead(road, Manoeuvre(then=-5.0), NONE).lateral_acceleration == 0.0


def test_looking_ahead_moves_nothing(empty_road):
    road = at_speed(empty_road(), 8.0)
    before = road.bodies.copy(), road.av.position.copy(), road.av.heading, road.av.speed
    look_ahead(road, Manoeuvre(then=-5.0, hold=0.6, steering=0.3, acceleration=3.0), NONE)
    after = road.bodies, road.av.position, road.av.heading, road.av.speed
    assert all(np.array_equal(a, b) for a, b in zip(before, after))


def test_pursuit_leads_to_the_target():
    path = draw([Piece(60.0), arc(30.0, 1.2), Piece(120.0)])
    x, y, heading, speed = 0.0, -3.0, 0.2, 8.0
    for _ in range(250):
        wheel = pursue(x, y, heading, speed, 2.0, path.x, path.y, path.heading, 0.5, 5.0)
        assert abs(wheel) <= 0.5
        slip = math.atan(math.tan(wheel) / 2)
        x += speed * math.cos(heading + slip) * 0.1
        y += speed * math.sin(heading + slip) * 0.1
        heading += speed * math.sin(slip) / 2.5 * 0.1
    s, d = path.project((x, y))
    assert s > 150
    assert d == pytest.approx(2.0, abs=0.05)
    assert heading == pytest.approx(1.2, abs=0.02)


def test_pursuit_steers_straight_on_the_target_line():
    path = draw([Piece(100.0)])
    for speed in (0.0, 5.0, 15.0):
        args = (path.x, path.y, path.heading, 0.5, 5.0)
        assert pursue(10.0, 2.0, 0.0, speed, 2.0, *args) == pytest.approx(0.0)
        assert pursue(10.0, 0.0, 0.0, speed, 2.0, *args) > 0.0  # the target is on the right
