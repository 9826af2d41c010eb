"""Traffic: who enters, who gives way, who is removed, and whom a vehicle follows."""

from __future__ import annotations

import numpy as np
import pytest

from haim_torchrl.envs import PlatoonEnv
from haim_torchrl.envs.road import ROOM, STUCK_STEPS
from haim_torchrl.envs.scenario import Spawn
from haim_torchrl.envs.vehicles import RoadObstacle, StoppedVehicle, TrafficVehicle

COAST = np.array([0.0, 0.0])


def put_traffic(env, path: int, s: float, speed: float = 7.0, **spawn) -> TrafficVehicle:
    """Traffic on a path of the table: first the route's lanes, then the side roads."""
    lanes = env.scenario.lanes
    lane, side = (path, None) if path < lanes else (None, path - lanes)
    vehicle = TrafficVehicle(
        env.road, env.road.indices[path], Spawn(s, speed, lane, side, 0.0, **spawn)
    )
    env.road.vehicles.append(vehicle)
    env.road.refresh()
    return vehicle


@pytest.fixture
def crossing(empty_road) -> PlatoonEnv:
    """A straight road that other traffic crosses."""
    for seed in range(50):
        env = empty_road({"blocks": {"intersection": 1.0}, "block_count": 1}, initial_speed=8.0)
        env.reset(seed=seed)
        sides = env.scenario.sides
        if sides and np.ptp(env.scenario.route.heading) < 0.01:
            return env
    raise AssertionError("no crossing among 50 scenarios")


# Who is where.
def test_bodies_are_av_followers_others(empty_road, put_vehicle):
    env = empty_road()
    put_vehicle(env, 30.0)
    env.road.objects.append(RoadObstacle("cones", np.array([180.0, -2.0]), 0.0))
    env.road.refresh()
    bodies = env.road.bodies
    assert bodies.shape == (8, 10)
    assert bodies[0, :2].tolist() == env.vehicle.position.tolist()
    assert bodies[1:6, 0] == pytest.approx([95, 75, 55, 35, 15])
    assert env.road.others[:, 0] == pytest.approx([145.0, 180.0])
    assert env.road.others[:, 5:7].tolist() == [[2.5, 1.0], [1.5, 1.2]]
    assert env.road.route_s == pytest.approx(bodies[:, 0])


def test_leader_and_follower_along_a_lane(empty_road, put_vehicle):
    env = empty_road()
    lane = env.vehicle.lane_index[2]
    near, _far = put_vehicle(env, 30.0, lane=lane), put_vehicle(env, 50.0, lane=lane)
    beside = put_vehicle(env, 10.0, lane=1 - lane)
    front, rear = env.road.neighbour_vehicles(env.vehicle)
    assert front is near
    assert rear is env.road.platoon.vehicles[0]
    assert env.road.neighbour_vehicles(env.vehicle, env.road.indices[1 - lane])[0] is beside


def test_the_lane_that_a_place_is_on(empty_road):
    road = empty_road({"lanes": (3,)}).road
    names = [road.route_lane_index(np.array([150.0, y]))[2] for y in (-9.0, -3.0, 1.0, 3.0, 30.0)]
    assert names == [0, 0, 1, 2, 2]


def test_decelerations_outlast_the_arrival_of_others(empty_road):
    """The prediction needs them; a second look in the same step must not reset them."""
    env = empty_road()
    vehicle = put_traffic(env, 0, 160.0)
    vehicle.speed = 7.0
    env.step(COAST)
    put_traffic(env, 0, 152.0)
    vehicle.speed = 5.0
    env.road.refresh(0.1)
    before = env.road.others[0, 4]
    assert before < -10.0
    put_traffic(env, 1, 190.0)
    assert env.road.others[0, 4] == before
    env.road.remove([6 + 2])
    assert env.road.others[0, 4] == before


# Traffic.
def test_traffic_stops_behind_what_stands_in_its_lane(empty_road, put_vehicle):
    env = empty_road()
    vehicle = put_traffic(env, 0, 150.0)
    vehicle.enable_lane_change = False
    put_vehicle(env, 75.0, lane=0)
    for _ in range(150):
        env.step(COAST)
    assert 5.0 < 190.0 - vehicle.position[0] < 12.0  # centre to centre; both are 5 m long
    assert vehicle.speed < 0.3


def test_traffic_overtakes_what_stands_in_its_lane(empty_road, put_vehicle):
    env = empty_road()
    vehicle = put_traffic(env, 0, 140.0)
    put_vehicle(env, 75.0, lane=0)
    lanes = set()
    for _ in range(100):
        env.step(COAST)
        lanes.add(vehicle.lane_index[2])
    assert lanes == {0, 1}
    assert vehicle.position[0] > 190.0


def test_traffic_is_removed_at_the_end_of_the_road(empty_road):
    env = empty_road()
    vehicle = put_traffic(env, 0, env.scenario.route.length - 5.0)
    for _ in range(10):
        env.step(COAST)
    assert vehicle not in env.road.vehicles


def test_traffic_that_is_stuck_is_removed(empty_road, put_vehicle):
    env = empty_road()
    vehicle = put_traffic(env, 0, 170.0)
    vehicle.enable_lane_change = False
    stopped = put_vehicle(env, 65.0, lane=0)
    steps = 0
    while vehicle in env.road.vehicles:
        env.step(COAST)
        steps += 1
        assert steps < 2 * STUCK_STEPS
    assert steps > STUCK_STEPS
    assert stopped in env.road.vehicles  # an obstacle is no traffic


def test_crashed_traffic_blocks_nobody(empty_road):
    """Traffic does not check collisions with traffic: no deadlock for the rest of the episode."""
    env = empty_road()
    a, b = put_traffic(env, 0, 170.0), put_traffic(env, 0, 173.0)
    for _ in range(100):
        env.step(COAST)
    assert not a.crashed
    assert max(a.position[0], b.position[0]) > 200.0


# Entering.
def test_traffic_enters_when_the_av_comes_near(empty_road):
    env = empty_road(initial_speed=10.0)
    env.road._waiting_spawns = [Spawn(200.0, 7.0, 0, None, 118.0)]
    count = len(env.road.vehicles)
    for _ in range(2):
        env.step(COAST)
        assert len(env.road.vehicles) == count
    env.step(COAST)  # from 115 m to 118 m at 10 m/s
    assert len(env.road.vehicles) == count + 1
    assert env.road.vehicles[-1].position.tolist() == pytest.approx([200.0, -2.0])


@pytest.mark.parametrize(("s", "enters"), [(145.0 + ROOM + 1.0, True), (145.0 + 4.0, False)])
def test_traffic_needs_room_to_enter(empty_road, put_vehicle, s, enters):
    env = empty_road()
    put_vehicle(env, 30.0, lane=0)
    count = len(env.road.vehicles)
    env.road._waiting_spawns = [Spawn(s, 7.0, 0, None, 0.0)]
    env.road.spawn()
    assert len(env.road.vehicles) == count + enters
    assert not env.road._waiting_spawns


def test_two_that_enter_at_once_need_room_too(empty_road):
    env = empty_road()
    count = len(env.road.vehicles)
    env.road._waiting_spawns = [Spawn(s, 7.0, 0, None, 0.0) for s in (200.0, 204.0, 215.0)]
    env.road.spawn()
    assert len(env.road.vehicles) == count + 2


# Junctions.
def test_cross_traffic_waits_for_the_av_and_the_platoon(crossing):
    env = crossing
    side = env.scenario.sides[0]
    middle = (side.conflict[0] + side.conflict[1]) / 2
    vehicle = put_traffic(env, env.scenario.lanes, side.give_way_at - 40.0)
    waited, nearest, platoon_at = 0, 99.0, None
    while platoon_at is None:
        env.step(COAST)
        waited += vehicle.waiting
        nearest = min(nearest, *np.hypot(*(env.road.bodies[:6, :2] - vehicle.position).T))
        if side.path.project(vehicle.position)[0] > side.give_way_at:
            platoon_at = env.road.route_s[:6].copy()
    assert waited > 20
    assert platoon_at.min() > middle  # the last follower, too
    assert nearest > 4.0


def test_cross_traffic_goes_when_nobody_comes(crossing):
    env = crossing
    env.vehicle.speed = 0.0
    side = env.scenario.sides[0]
    vehicle = put_traffic(env, env.scenario.lanes, side.give_way_at - 20.0)
    for _ in range(80):
        env.step(COAST)
        assert not vehicle.waiting
    assert side.path.project(vehicle.position)[0] > side.give_way_at


@pytest.mark.parametrize(("patience", "gives_way"), [(3.0, False), (6.0, True)])
def test_patience_is_the_time_that_is_left_to_others(crossing, patience, gives_way):
    env = crossing
    side = env.scenario.sides[0]
    vehicle = put_traffic(env, env.scenario.lanes, side.give_way_at - 5.0, patience=patience)
    env.vehicle.position = np.array([side.conflict[0] - 8.0 * 4.5, 2.0])  # 4.5 s away
    for follower in env.road.platoon.vehicles:
        follower.position = np.array([20.0, 2.0])
    env.road.refresh()
    assert env.road.must_give_way(vehicle) is gives_way


def test_who_drives_on_the_route_has_priority(crossing):
    vehicle = put_traffic(crossing, 0, 150.0)
    assert crossing.road.give_way_line(vehicle) is None
    assert not crossing.road.must_give_way(vehicle)


# Obstacles.
@pytest.mark.parametrize(
    ("kind", "things"),
    [
        ("cones", {(RoadObstacle, 0.0)}),
        ("triangle", {(RoadObstacle, 0.0), (StoppedVehicle, 0.0)}),
        ("stopped", {(StoppedVehicle, 0.0)}),
        ("slow", {(StoppedVehicle, 2.5)}),
    ],
)
def test_obstacles_stand_in_the_middle_of_their_lane(empty_road, kind, things):
    env = empty_road({"obstacles": (0.0, 1.0), "obstacle_kinds": {kind: 1.0}})
    (placed,) = env.scenario.obstacles
    found = [*env.road.vehicles[6:], *env.road.objects]
    assert {(type(thing), thing.speed) for thing in found} == things
    for thing in found:
        assert thing.position[1] == pytest.approx((-2.0, 2.0)[placed.lane])
    first = min(thing.position[0] for thing in found)
    assert first == pytest.approx(placed.s, abs=0.01)  # a triangle warns before the vehicle


def test_slow_vehicles_crawl_along_their_lane(empty_road):
    env = empty_road({"obstacles": (0.0, 1.0), "obstacle_kinds": {"slow": 1.0}})
    vehicle = env.road.vehicles[6]
    before = vehicle.position.copy()
    for _ in range(20):
        env.step(COAST)
    assert vehicle.position - before == pytest.approx([5.0, 0.0])


def test_removing_spares_the_av_and_its_followers(empty_road, put_vehicle):
    env = empty_road()
    vehicle = put_vehicle(env, 30.0)
    env.road.remove([0, 3, 6])
    assert vehicle not in env.road.vehicles
    assert len(env.road.vehicles) == 6
    assert len(env.road.bodies) == 6
