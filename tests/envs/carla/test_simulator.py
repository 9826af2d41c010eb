"""The simulator on a stand-in for a server: real maps and waypoints, kinematic cars."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from haim_torchrl.envs.carla.frames import centre_of, transform_of
from haim_torchrl.envs.driving import FLAGS, FLOATS, PLATOON, as_torch_env
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import RiskSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform

pytest.importorskip("carla")
ROAD, LANE, VEHICLES, OBSTACLES, ROUTE = range(5)
GO, COAST, BRAKE = np.array([1.0, 0.0]), np.array([0.0, 0.0]), np.array([-1.0, 0.0])
STRAIGHT = 1
"""A scenario that begins on a straight road."""


def start_ahead(sim, s: float, d: float = 0.0):
    """The transform of a place on the route, `s` [m] ahead of the AV's start."""
    scenario = sim._drive.scenario
    return transform_of(scenario.route.path.at(scenario.start + s, d))


def put(server, name: str, transform):
    """Something in the world that is none of the simulator's."""
    return server.world.try_spawn_actor(server.world.get_blueprint_library().find(name), transform)


def test_it_starts_straight(simulator):
    """So that the values by hand below hold."""
    sim = simulator()
    sim.reset(seed=STRAIGHT)
    scenario = sim._drive.scenario
    ahead = scenario.route.path.part(scenario.start - 5, scenario.start + 60)
    assert np.ptp(np.unwrap(ahead.heading)) < 1e-6


def test_torchrls_checker_is_content(simulator):
    check_env_specs(as_torch_env(simulator(traffic=2)), seed=0)


def test_entries_are_those_of_the_contract(simulator):
    env = as_torch_env(simulator(followers=3))
    root = env.reset()
    step = env.step(root.set("action", torch.tensor([0.5, 0.0])))
    for place in (root, step["next"]):
        assert place["pixels"].shape == (5, 84, 84)
        assert place["pixels"].dtype == torch.uint8
        assert place["state"].shape == (1,)
        for key in (*FLOATS, *FLAGS):
            assert place[key].shape == (1,)
        for key in PLATOON:
            assert place[key].shape == (3,)
    # Half a pedal gives the stand-in's car 2 m/s² from a standstill.
    assert step["next", "speed"].item() == pytest.approx(0.2, abs=1e-4)
    assert step["next", "acceleration"].item() == pytest.approx(2.0, abs=1e-3)


def test_ten_steps_by_hand(simulator):
    """4 m/s² for 1 s: 4 m/s, and 0.04 (1 + 2 + ... + 10) = 2.2 m."""
    sim = simulator()
    _, info = sim.reset(seed=STRAIGHT)
    assert (info["speed"], info["progress"], info["cost"]) == (0.0, pytest.approx(0.0, abs=1e-3), 0)
    rewards = [sim.step(GO)[1] for _ in range(10)]
    info = sim.step(BRAKE)[4]
    scenario = sim._drive.scenario
    way = scenario.route.path.length - 8.0 - scenario.start
    assert info["speed"] == pytest.approx(3.2, abs=1e-3)
    assert info["acceleration"] == pytest.approx(-8.0, abs=1e-2)
    assert info["progress"] == pytest.approx((2.2 + 0.32) / way, abs=1e-3)
    assert sum(rewards) == pytest.approx(2.2 + 0.1 * (0.4 * 55) / 15, abs=0.02)
    assert sim.snapshot().time == pytest.approx(1.1)
    assert sim.snapshot().distance == pytest.approx(2.52, abs=1e-3)


def test_steering_to_the_right_leads_to_the_right(simulator):
    sim = simulator()
    sim.reset(seed=STRAIGHT)
    for _ in range(10):
        sim.step(GO)
    before = sim.road.route_d[0]
    for _ in range(5):
        sim.step(np.array([0.0, 0.3]))
    assert sim.road.route_d[0] > before + 0.05


def test_followers_follow_and_stand_where_the_platoon_says(server, simulator):
    sim = simulator()
    _, info = sim.reset(seed=STRAIGHT)
    np.testing.assert_allclose(info["follower_gaps"], 15.0)
    for _ in range(100):
        info = sim.step(np.array([0.3, 0.0]))[4]
        assert (info["follower_gaps"] > 2.0).all()
    assert (info["follower_speeds"] > 3.0).all()
    for _ in range(40):
        info = sim.step(BRAKE)[4]
    assert info["speed"] == 0.0
    assert (info["follower_gaps"] > 2.0).all()
    boxes = sim.snapshot().followers
    sim.step(BRAKE)  # the server shows them a step later
    actors = [a for a in server.alive if a.attributes.get("role_name") == "follower"]
    assert not any(actor.physics for actor in actors)
    for actor, box in zip(actors, boxes, strict=True):
        x, y, heading = centre_of(actor.get_transform(), actor.bounding_box)
        assert (x, -y) == pytest.approx(tuple(box[:2]), abs=1e-3)
        assert np.cos(heading + box[2]) == pytest.approx(1.0)


def test_snapshots_have_y_to_the_left(server, simulator):
    sim = simulator(traffic=3, pedestrians=2, obstacles=[0.0, 1.0])
    sim.reset(seed=4)
    scene = sim.snapshot()
    hero = next(a for a in server.alive if a.attributes.get("role_name") == "hero")
    at = hero.get_transform()
    assert scene.vehicle[1] == pytest.approx(-at.location.y, abs=0.2)
    assert np.cos(scene.vehicle[2] + np.radians(at.rotation.yaw)) == pytest.approx(1.0)
    np.testing.assert_allclose(scene.vehicle[3:], [4.8, 1.9], atol=1e-6)
    assert scene.followers.shape == (5, 5)
    assert scene.traffic.shape == (3, 5)
    assert scene.obstacles.shape == (3, 5)
    route = next(line for line in sim.road_polylines() if line.route)
    gaps = np.hypot(*(route.points - scene.vehicle[:2]).T)
    assert gaps.min() < 0.6
    assert sim.scenario_labels().index == 4
    assert sim.scenario_labels().obstacles == 1


def test_traffic_minds_the_seed_and_no_lights(server, simulator):
    sim = simulator(traffic=4)
    sim.reset(seed=7)
    first = sim.snapshot().traffic
    cars = [a for a in server.alive if a.autopilot]
    assert len(cars) == 4
    assert {(a.id, 100.0) for a in cars} == set(server.managers[8000].ignoring)
    assert not any("bike" in a.type_id for a in cars)
    types = [a.type_id for a in cars]
    sim.reset(seed=8)
    assert not np.allclose(sim.snapshot().traffic, first)
    sim.reset(seed=7)
    np.testing.assert_allclose(sim.snapshot().traffic, first, atol=1e-6)
    assert [a.type_id for a in server.alive if a.autopilot] == types


def test_a_collision_ends_the_episode_and_measures_no_braking(server, simulator):
    sim = simulator()
    sim.reset(seed=STRAIGHT)
    put(server, "static.prop.streetbarrier", start_ahead(sim, 12.0))
    for _ in range(60):
        _, _, terminated, truncated, info = sim.step(GO)
        if terminated:
            break
    assert info["crash"]
    assert info["cost"] == 1.0
    assert info["acceleration"] == 0.0
    assert not (truncated or info["success"])


def test_a_lasting_contact_costs_once(server, simulator):
    """A thing that is no actor of the simulator's stays, and the car drives through it."""
    sim = simulator(end_on_collision=False)
    sim.reset(seed=STRAIGHT)
    put(server, "static.prop.streetbarrier", start_ahead(sim, 12.0))
    costs = [sim.step(np.array([0.4, 0.0]))[4]["cost"] for _ in range(60)]
    assert sum(costs) == 1.0


def test_an_obstacle_that_was_hit_is_taken_away(server, simulator):
    sim = simulator(end_on_collision=False, obstacles=[0.0, 1.0], obstacle_offset=0.0)
    sim.reset(seed=STRAIGHT)
    expert = ExpertMentor()
    expert.reset(sim)
    total = 0.0
    for _ in range(900):
        steering = float(expert.act(sim)[1])
        _, _, terminated, _, info = sim.step(np.array([0.5, steering]))
        total += info["cost"]
        if terminated or total:
            break
    assert total == 1.0
    assert not terminated
    assert sim.snapshot().obstacles.shape == (0, 5)
    assert not any("static" in actor.type_id for actor in server.alive)


def test_leaving_the_road_ends_the_episode(simulator):
    sim = simulator()
    sim.reset(seed=STRAIGHT)
    for _ in range(100):
        _, _, terminated, _, info = sim.step(np.array([0.5, 0.4]))
        if terminated:
            break
    assert info["out_of_road"]
    assert not info["crash"]


def test_an_episode_is_cut_off_at_the_horizon(simulator):
    sim = simulator(horizon=3)
    sim.reset(seed=0)
    ends = [sim.step(COAST)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_standing_without_cause_is_counted(server, simulator):
    sim = simulator()
    sim.reset(seed=STRAIGHT)
    for _ in range(5):
        sim.step(COAST)
    assert sim.forecast(COAST).stalled_steps == 5
    for _ in range(10):
        sim.step(GO)
    assert sim.forecast(GO).stalled_steps == 0
    prop = put(server, "static.prop.trafficcone01", start_ahead(sim, 12.0, 1.8))
    sim._drive._cast.props.append(prop)
    for _ in range(20):
        sim.step(BRAKE)
    assert sim.forecast(BRAKE).stalled_steps > 10  # it stands beside the way
    put(server, "vehicle.audi.a2", start_ahead(sim, 14.0))
    sim._drive._cast.traffic.append(server.alive[-1])
    for _ in range(20):
        sim.step(BRAKE)
    assert sim.forecast(BRAKE).stalled_steps == 0  # somebody is in the way


def test_forecasts(simulator, server):
    sim = simulator(obstacles=[0.0, 1.0], obstacle_offset=0.0)
    sim.reset(seed=STRAIGHT)
    for _ in range(20):
        sim.step(GO)
    free = sim.forecast(COAST)
    assert not (free.collision or free.departure)
    assert free.clearance == pytest.approx(2.0, abs=0.05)  # half of the lane
    turn = sim.forecast(np.array([0.0, 1.0]))
    assert turn.departure
    assert 0.0 < turn.time_to_departure < 2.0
    assert turn.lateral_acceleration > 5.0
    car = put(server, "vehicle.audi.a2", start_ahead(sim, 28.0))
    sim._drive._cast.traffic.append(car)
    sim.step(COAST)
    ahead = sim.forecast(GO)
    assert ahead.collision
    assert 0.5 < ahead.time_to_collision < 3.0
    assert not sim.forecast(BRAKE).collision


def test_what_comes_towards_one_in_a_bend_is_foreseen_in_its_own_lane(server, simulator):
    """Straight on it would come across the AV's lane; along its lane it passes."""
    sim = simulator()
    for seed in range(40):
        sim.reset(seed=seed)
        if sim._drive.scenario.route.blocks[0] == "curve":
            break
    path, start = sim._drive.scenario.route.path, sim._drive.scenario.start
    bend = next(
        s for s in range(int(start), 400) if abs(path.heading[s + 20] - path.heading[s]) > 0.5
    )
    x, y, heading = path.at(bend + 25.0, -4.0)
    car = put(server, "vehicle.audi.a2", transform_of((x, y, heading + np.pi)))
    hero = sim._drive._cast.av
    hero.set_transform(transform_of(path.at(bend)))
    car.push(10.0)
    sim._drive._cast.traffic.append(car)
    for _ in range(int(bend - start)):  # let progress catch up with the jump
        sim._drive._progress.update(path.at(float(bend)))
    sim.step(COAST)
    assert sim.road.bodies[-1, 7] > 0  # it drives along a lane
    assert not sim.forecast(COAST).collision


@pytest.mark.parametrize("seed", [0, 3, 4])
def test_the_expert_arrives_with_its_followers(simulator, seed):
    """By `road`, which the expert of the other worlds reads, through bends and junctions."""
    sim = simulator(traffic=8, obstacles=[0.0, 1.0])
    sim.reset(seed=seed)
    expert = ExpertMentor()
    expert.reset(sim)
    for _ in range(1000):
        _, reward, terminated, truncated, info = sim.step(expert.act(sim).numpy())
        assert (info["follower_gaps"] > 0.5).all()
        if terminated or truncated:
            break
    assert info["success"]
    assert info["progress"] == 1.0
    assert reward > 20.0


def test_the_image_shows_what_is_where(server, simulator):
    sim = simulator()
    observation, _ = sim.reset(seed=STRAIGHT)
    image = observation["pixels"]
    rows, columns = image[VEHICLES].nonzero()
    assert len(rows)  # the first follower, 17.5 to 22.5 m behind: below the middle of the image
    assert rows.min() > 60
    assert abs(columns.mean() - 41.5) < 1.0
    assert image[ROUTE, :50, 40:44].min() > 200
    assert image[ROAD, 40].max() == 255
    oncoming, pavement = 42 - round(4.0 / 0.714), 42 + round(5.0 / 0.714)
    assert image[ROAD, 40, oncoming] > 200  # the oncoming lane, on the left
    assert image[ROAD, 40, pavement] < 60  # traffic drives on the right
    prop = put(server, "static.prop.trafficcone01", start_ahead(sim, 20.0, 3.0))
    sim._drive._cast.props.append(prop)
    image = sim.step(COAST)[0]["pixels"]
    rows, columns = image[OBSTACLES].nonzero()
    assert abs((40.0 - rows.mean() * 60 / 84) - 20.0) < 1.0
    assert abs((columns.mean() + 0.5 - 42) * 60 / 84 - 3.0) < 0.8


def test_a_shielded_random_driver_learns_in_this_world(simulator):
    """Mentor, switch and disturbance are those of the other worlds."""
    sim = simulator(traffic=4)
    env = TransformedEnv(as_torch_env(sim))
    env.append_transform(InterventionTransform(ExpertMentor, RiskSwitch))
    env.append_transform(DisturbanceTransform())
    torch.manual_seed(0)
    rollout = env.rollout(80, break_when_any_done=False)
    assert rollout["next", "intervention"].any()
    assert not rollout["next", "crash"].any()
    assert rollout["next", "disturbance_cost"].shape == (80, 1)


def test_nothing_can_be_asked_before_the_first_reset(simulator):
    sim = simulator()
    for question in (sim.snapshot, sim.road_polylines, sim.scenario_labels, lambda: sim.step(GO)):
        with pytest.raises(RuntimeError, match="call reset"):
            question()


def test_seeding_moves_nothing_and_draws_the_same_scenarios(server, simulator):
    """TorchRL seeds with numbers that are no scenarios of the set."""
    env = as_torch_env(simulator(first_scenario=100, scenarios=1000))

    def drawn() -> list[int]:
        env.set_seed(4_000_000_000)
        calls.append(list(server.calls))
        numbers = []
        for _ in range(3):
            env.reset()
            numbers.append(env._env.unwrapped.scenario_labels().index)
        return numbers

    calls: list[list[str]] = []
    first, second = drawn(), drawn()
    assert first == second
    assert calls[0] == []
    assert len(set(first)) > 1
    assert all(100 <= number < 1100 for number in first)


def test_towns_by_seed(server, simulator):
    sim = simulator()
    sim.reset(seed=3)
    sim.reset(seed=20_003)
    sim.reset(seed=20_004)
    sim.reset(seed=3)
    loads = [call for call in server.calls if call.startswith("load")]
    assert loads == ["load Town01", "load Town02", "load Town01"]
    with pytest.raises(ValueError, match="scenario -1 does not exist"):
        sim.reset(seed=-1)
