"""The MetaDrive world keeps the contract of a driving simulator, in SI units."""

import math

import numpy as np
import pytest
from metadrive.component.static_object.traffic_object import TrafficBarrier

from haim_torchrl.mentors.expert import ExpertMentor

STRAIGHT = np.array([0.0, 0.0])
FULL = np.array([1.0, 0.0])


def put_barrier(simulator, ahead):
    """A barrier in the AV's lane, so many metres ahead of its centre."""
    agent = simulator.agent
    s, _ = agent.lane.local_coordinates(agent.position)
    simulator._env.engine.traffic_manager.spawn_object(
        TrafficBarrier,
        lane=agent.lane,
        position=agent.lane.position(s + ahead, 0.0),
        heading_theta=agent.lane.heading_theta_at(s + ahead),
        static=True,
    )


def test_the_observation_is_the_papers(free_road):
    observation, info = free_road.reset(seed=0)
    assert observation.shape == (259,)
    assert observation.dtype == np.float32
    assert free_road.observation_space.contains(observation)
    assert free_road.reflection is None
    assert info["speed"] == info["acceleration"] == info["cost"] == info["progress"] == 0.0
    assert not any(info[key] for key in ("success", "crash", "out_of_road", "wrong_way"))


def test_the_agents_own_motion_is_told_only_if_asked_for(make_simulator):
    for motion in (False, True):
        simulator = make_simulator(
            traffic_density=0.0,
            accident_probability=0.0,
            observation={"view": "rays", "motion": motion},
        )
        simulator.reset(seed=0)
        observation = simulator.step(np.array([0.5, 0.4]))[0]
        assert observation.shape == (259,)
        assert bool((observation[4:8] == 0.5).all()) is not motion


def test_full_throttle_and_full_brake_by_hand(free_road):
    free_road.reset(seed=0)
    for _ in range(20):
        info = free_road.step(FULL)[-1]
    assert info["acceleration"] == pytest.approx(2.76, rel=0.08)
    assert info["speed"] == pytest.approx(2.0 * 2.76, rel=0.08)  # 2 s from a standstill
    info = free_road.step(np.array([-1.0, 0.0]))[-1]
    assert info["acceleration"] == pytest.approx(-8.0, rel=0.08)
    assert free_road.minimum_acceleration == -8.0
    info = free_road.step(np.array([-0.25, 0.0]))[-1]
    assert info["acceleration"] == pytest.approx(-2.0, rel=0.1)


def test_the_paper_s_speed_limit_holds(free_road):
    free_road.reset(seed=0)
    speeds = []
    for _ in range(60):
        *_, terminated, _, info = free_road.step(FULL)
        speeds.append(info["speed"])
        if terminated:
            break
    assert 10.5 < max(speeds) < 11.5  # 40 km/h


def test_positive_steering_turns_right_as_a_bicycle_does(free_road):
    free_road.reset(seed=0)
    for _ in range(15):
        free_road.step(FULL)
    before = free_road.agent.heading_theta
    for _ in range(4):
        free_road.step(np.array([0.1, 0.3]))
    early = free_road.agent.heading_theta
    free_road.step(np.array([0.1, 0.3]))
    rate = (early - free_road.agent.heading_theta) / 0.1  # MetaDrive's angles grow to the left
    assert early < before
    expected = free_road.road.av.speed * math.tan(0.3 * 0.35) / 2.5
    assert rate == pytest.approx(expected, rel=0.1)


def test_the_same_scenario_is_the_same_whatever_came_before(make_simulator):
    simulator = make_simulator()

    def drive(seed):
        seen = [simulator.reset(seed=seed)[0]]
        seen += [simulator.step(np.array([0.4, 0.01]))[0] for _ in range(25)]
        return np.array(seen)

    first = drive(3)
    drive(5)
    np.testing.assert_array_equal(drive(3), first)


def test_an_expert_arrives(free_road):
    _, info = free_road.reset(seed=1)
    expert = ExpertMentor()
    expert.reset(free_road)
    total, cost = 0.0, 0.0
    for _ in range(900):
        _, reward, terminated, truncated, info = free_road.step(expert.act(free_road).numpy())
        total, cost = total + reward, cost + info["cost"]
        if terminated or truncated:
            break
    assert terminated
    assert info["success"]
    assert info["progress"] == pytest.approx(1.0, abs=0.02)
    assert cost == 0.0
    # Reward: a metre of progress each, 0.1 for speed in each step, and 20 on arrival.
    driven = free_road.road.scenario.route.length - free_road._start
    assert driven < total < driven + 20.0 + 0.1 * 900


def test_leaving_the_route_ends_the_episode(free_road):
    free_road.reset(seed=0)
    for _ in range(100):
        *_, terminated, truncated, info = free_road.step(np.array([0.8, 0.4]))
        if terminated:
            break
    assert terminated
    assert not truncated
    assert info["out_of_road"]
    assert not info["success"]


def test_a_collision_is_one_event_however_long_the_contact(free_road):
    free_road.reset(seed=0)
    put_barrier(free_road, 25.0)
    infos = [free_road.step(FULL)[-1] for _ in range(70)]
    contact = [info["crash"] for info in infos]
    assert sum(info["cost"] for info in infos) == 1.0
    assert sum(contact) == 1
    hit = contact.index(True)
    assert infos[hit - 1]["speed"] > 5.0
    assert infos[hit]["acceleration"] == 0.0  # a crash is no braking


def test_an_episode_may_end_on_collision(make_simulator):
    simulator = make_simulator(traffic_density=0.0, accident_probability=0.0, end_on_collision=True)
    simulator.reset(seed=0)
    put_barrier(simulator, 20.0)
    for _ in range(70):
        *_, terminated, _, info = simulator.step(FULL)
        if terminated:
            break
    assert terminated
    assert info["crash"]


def test_the_horizon_truncates(make_simulator):
    simulator = make_simulator(traffic_density=0.0, accident_probability=0.0, horizon=5)
    simulator.reset(seed=0)
    ends = [simulator.step(STRAIGHT)[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]


def test_resets_draw_from_the_set_and_seeding_repeats_them(free_road):
    def draws():
        free_road.seed_draws(7)
        return [free_road.reset() and free_road.scenario_labels().index for _ in range(4)]

    first = draws()
    assert set(first) <= set(range(10))
    assert draws() == first


@pytest.mark.parametrize("action", [[math.nan, 0.0], [0.0, math.inf]])
def test_an_action_that_is_no_number_is_refused(free_road, action):
    free_road.reset(seed=0)
    with pytest.raises(ValueError, match="two finite numbers"):
        free_road.step(np.array(action))


def test_the_route_view_has_a_mirror(make_simulator):
    simulator = make_simulator()
    observation, _ = simulator.reset(seed=2)
    size = simulator.observation_space.shape[0]
    assert observation.shape == (size,)
    assert simulator.reflection is not None
    assert observation[0] == 0.0  # speed
    # The carriageway is three lanes of 3.5 m: the two edges are 10.5 m apart, in units of 4 m.
    assert observation[2] + observation[3] == pytest.approx(10.5 / 4.0, abs=1e-4)


def test_the_image_shows_road_followers_and_route(make_simulator):
    observation = {"view": "semantic", "size": 42}
    settings = {"traffic_density": 0.0, "accident_probability": 0.0, "observation": observation}
    simulator = make_simulator(**settings)
    seen, _ = simulator.reset(seed=0)
    assert set(seen) == {"pixels", "state"}
    assert seen["pixels"].shape == (5, 42, 42)
    assert seen["pixels"].dtype == np.uint8
    assert simulator.observation_space.contains(seen)
    road, lane, vehicles, obstacles, route = seen["pixels"]
    row, column = 28, 21  # the AV: 40 of 60 m lie ahead
    assert road[row, column] == route[row, column] == 255
    assert lane.any()
    assert not obstacles.any()
    assert vehicles[row + 11 :, column - 1 : column + 2].any()  # the first follower, 20 m behind
    assert not vehicles[:row].any()
    for _ in range(10):
        seen = simulator.step(FULL)[0]
    assert seen["state"][0] == pytest.approx(2.76 / 15.0, rel=0.1)
    assert simulator.reflection is not None
