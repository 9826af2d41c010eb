"""The world as a Gymnasium environment: events, measurements, determinism and settings."""

from __future__ import annotations

import math
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from haim_torchrl.envs import PlatoonConfig, PlatoonEnv, make_gym_env
from haim_torchrl.envs.scenario import START
from haim_torchrl.envs.vehicles import RoadObstacle
from haim_torchrl.evaluation.recording import Recordable
from haim_torchrl.switches.protocol import Forecasting

COAST = np.array([0.0, 0.0], dtype=np.float32)
FULL = np.array([1.0, 0.0], dtype=np.float32)
BRAKE = np.array([-1.0, 0.0], dtype=np.float32)
EVENTS = ("crash", "out_of_road", "wrong_way", "success")


def place_av(env: PlatoonEnv, s: float, speed: float = 0.0, d: float | None = None) -> None:
    """Put the AV somewhere on the route (the followers stay where they are)."""
    own = float(env.road.route_d[0]) if d is None else d
    x, y, heading = env.scenario.route.at(s, own)
    env.vehicle.position, env.vehicle.heading, env.vehicle.speed = np.array([x, y]), heading, speed
    env.road.refresh()


def happened(info) -> set[str]:
    return {name for name in EVENTS if info[name]}


def play(env: PlatoonEnv, seed: int, steps: int = 80) -> list[np.ndarray]:
    """Everything that an episode of a fixed driver shows."""
    observation, info = env.reset(seed=seed)
    shown = [observation]
    rng = np.random.default_rng(0)
    for _ in range(steps):
        action = np.array([0.4, 0.0]) + rng.normal(0, [0.3, 0.01])
        observation, reward, *ends, info = env.step(action.astype(np.float32))
        numbers = [v for k, v in info.items() if not k.startswith("follower")]
        followers = [info["follower_gaps"], info["follower_speeds"]]
        shown += [observation, np.array([reward, *ends, *numbers], dtype=float), *followers]
        shown.append(env.road.bodies.copy())
        if any(ends):
            break
    return shown


# Ends of an episode.
def test_a_collision_ends_the_episode(empty_road, put_vehicle):
    env = empty_road(initial_speed=10.0)
    put_vehicle(env, 15.5, lane=env.vehicle.lane_index[2])  # 10.5 m from bumper to bumper
    for _ in range(10):
        _, _, terminated, truncated, info = env.step(COAST)
        assert not (terminated or truncated or info["cost"])
    _, _, terminated, truncated, info = env.step(BRAKE)
    assert terminated
    assert not truncated
    assert happened(info) == {"crash"}
    assert info["cost"] == 1.0
    assert info["acceleration"] == 0.0  # a crash frame says nothing about the braking


@pytest.mark.parametrize("kind", ["cones", "triangle"])
def test_obstacles_can_be_hit(empty_road, kind):
    env = empty_road(initial_speed=10.0)
    env.road.objects.append(RoadObstacle(kind, env.vehicle.position + np.array([8.0, 1.5]), 0.0))
    env.road.refresh()
    for _ in range(12):
        *_, terminated, _, info = env.step(COAST)
        if terminated:
            break
    assert happened(info) == {"crash"}


def test_otherwise_what_was_hit_is_removed(empty_road, put_vehicle):
    env = empty_road(initial_speed=10.0, end_on_collision=False)
    hit = put_vehicle(env, 15.5, lane=env.vehicle.lane_index[2])
    costs = []
    for _ in range(30):
        _, _, terminated, truncated, info = env.step(COAST)
        assert not (terminated or truncated)
        costs.append(info["cost"])
    assert sum(costs) == 1.0
    assert hit not in env.road.vehicles
    assert info["speed"] == 10.0


def test_leaving_the_road(empty_road):
    env = empty_road(initial_speed=5.0)
    place_av(env, 150.0, 5.0, d=3.6)
    env.vehicle.heading = 0.9
    *_, terminated, truncated, info = env.step(COAST)
    assert not terminated  # 3.99 m, and the edge is at 4 m
    *_, terminated, truncated, info = env.step(COAST)
    assert terminated
    assert not truncated
    assert happened(info) == {"out_of_road"}


def test_the_wrong_way(empty_road):
    env = empty_road()
    place_av(env, 150.0, 2.0, d=0.0)
    env.vehicle.heading = math.radians(80)
    *_, terminated, _, info = env.step(COAST)
    assert not terminated
    env.vehicle.heading = math.radians(100)
    *_, terminated, _, info = env.step(COAST)
    assert terminated
    assert happened(info) == {"wrong_way"}


def test_time_runs_out(empty_road):
    env = empty_road(horizon=4)
    ends = [env.step(COAST)[2:4] for _ in range(4)]
    assert ends == [(False, False)] * 3 + [(False, True)]


def test_an_end_in_the_last_step_is_no_time_out(empty_road):
    env = empty_road(horizon=1)
    place_av(env, 150.0, 10.0, d=3.9)
    env.vehicle.heading = 1.0
    *_, terminated, truncated, _ = env.step(COAST)
    assert (terminated, truncated) == (True, False)


def test_arriving(empty_road):
    env = empty_road()
    place_av(env, env.scenario.route.length - 9.5, 10.0)
    _, reward, terminated, _, info = env.step(COAST)
    assert not terminated
    _, reward, terminated, truncated, info = env.step(COAST)
    assert (terminated, truncated) == (True, False)
    assert happened(info) == {"success"}
    assert info["progress"] == 1.0
    assert reward == pytest.approx(1.0 + 0.1 * 10 / 15 + 20.0)


def test_arriving_with_a_crash_is_no_success(empty_road, put_vehicle):
    env = empty_road()
    place_av(env, env.scenario.route.length - 8.5, 10.0)
    put_vehicle(env, 5.5, lane=env.vehicle.lane_index[2])
    *_, terminated, _, info = env.step(COAST)
    assert terminated
    assert happened(info) == {"crash"}


# Measurements.
def test_what_a_reset_reports():
    env = PlatoonEnv({"followers": 3})
    _, info = env.reset(seed=1)
    assert info["acceleration"] == info["cost"] == info["speed"] == info["progress"] == 0.0
    assert not happened(info)
    assert info["follower_gaps"].tolist() == [15.0] * 3
    assert info["follower_speeds"].tolist() == [0.0] * 3
    assert info["follower_gaps"].dtype == info["follower_speeds"].dtype == np.float32


def test_the_acceleration_is_measured(empty_road):
    env = empty_road(initial_speed=10.0)
    assert env.step(COAST)[-1]["acceleration"] == 0.0
    assert env.step(np.array([0.5, 0.0]))[-1]["acceleration"] == pytest.approx(2.0)
    assert env.step(BRAKE)[-1]["acceleration"] == pytest.approx(-8.0)
    assert env.minimum_acceleration == -8.0
    env.vehicle.speed = 0.3
    assert env.step(BRAKE)[-1]["acceleration"] == pytest.approx(-3.0)  # no more than to a stop
    env.vehicle.speed = 14.9
    assert env.step(FULL)[-1]["acceleration"] == pytest.approx(1.0)


def test_progress_and_reward_by_hand(empty_road):
    env = empty_road(initial_speed=6.0)
    span = env.scenario.route.length - 8.0 - START
    _, reward, *_, info = env.step(FULL)
    assert info["progress"] == pytest.approx(0.6 / span)
    assert reward == pytest.approx(0.6 + 0.1 * 6.4 / 15)
    assert env.distance == pytest.approx(0.6)
    assert env.time == pytest.approx(0.1)


def test_followers_react_to_the_av(empty_road):
    env = empty_road(initial_speed=10.0)
    for _ in range(60):
        *_, info = env.step(COAST)
    steady = info["follower_gaps"].copy()
    for _ in range(12):
        *_, info = env.step(BRAKE)
    assert info["follower_gaps"][0] < steady[0] - 3.0
    assert info["follower_speeds"][0] < 8.0
    assert info["follower_speeds"][0] < info["follower_speeds"][4]


def test_standing_on_a_free_road_is_stalling(empty_road):
    env = empty_road()
    counts = []
    for action in [COAST] * 12 + [FULL] * 30 + [COAST] * 10:
        env.step(action)
        counts.append(env.stalled)
    assert counts[:12] == list(range(1, 13))
    assert counts[30:] == [0] * 22


def test_being_held_up_is_not(empty_road, put_vehicle):
    env = empty_road(initial_speed=2.5)
    put_vehicle(env, 12.0, lane=env.vehicle.lane_index[2], speed=2.5)
    for _ in range(20):
        env.step(COAST)
        assert env.stalled == 0


# Scenarios and seeds.
def test_the_same_seed_gives_the_same_episode():
    used = PlatoonEnv()
    play(used, 5, steps=20)
    for seed in (3, 20_004):
        first, second = play(PlatoonEnv(), seed), play(used, seed)
        assert len(first) == len(second) > 50
        assert all(np.array_equal(a, b) for a, b in zip(first, second))


def test_resets_without_a_seed_draw_from_the_set():
    env = PlatoonEnv({"first_scenario": 700, "scenarios": 4, "scenario": {"block_count": 1}})
    env.reset(seed=12)
    assert env.scenario.seed == 12
    drawn = []
    for _ in range(40):
        env.reset()
        drawn.append(env.scenario.seed)
    assert set(drawn) == {700, 701, 702, 703}
    env.reset(seed=12)
    again = []
    for _ in range(40):
        env.reset()
        again.append(env.scenario.seed)
    assert again == drawn


def test_the_scenarios_labels():
    env = PlatoonEnv()
    env.reset(seed=11)
    labels = env.scenario_labels()
    assert labels.index == 11
    assert labels.blocks == tuple(kind for kind, _, _ in env.scenario.blocks)
    assert labels.obstacles == len(env.scenario.obstacles)


# Recordings and pictures.
def test_snapshots_by_hand(empty_road, put_vehicle):
    env = empty_road(initial_speed=6.0)
    place_av(env, 115.0, 6.0, d=2.0)
    put_vehicle(env, 40.0, lane=0)
    env.road.objects.append(RoadObstacle("cones", np.array([190.0, -2.0]), 0.0))
    env.road.refresh()
    env.step(COAST)
    shot = env.snapshot()
    assert isinstance(env, Recordable)
    assert shot.vehicle == pytest.approx([115.6, -2.0, 0.0, 5.0, 2.0])  # y grows to the left here
    assert (shot.time, shot.speed, shot.distance) == pytest.approx((0.1, 6.0, 0.6))
    assert shot.followers.shape == (5, 5)
    assert (np.diff(shot.followers[:, 0]) < 0).all()
    assert shot.follower_speeds.shape == shot.follower_gaps.shape == (5,)
    assert shot.traffic.shape == (0, 5)
    assert shot.obstacles == pytest.approx(
        np.array([[155.0, 2.0, 0.0, 5.0, 2.0], [190.0, 2.0, 0.0, 3.0, 2.4]])
    )


def test_snapshots_tell_traffic_from_obstacles():
    env = PlatoonEnv({"scenario": {"obstacles": (0.0, 1.0), "blocks": {"straight": 1.0}}})
    env.reset(seed=2)
    shot = env.snapshot()
    assert len(shot.traffic) + len(shot.obstacles) == len(env.road.others)
    assert len(shot.traffic) > 1
    assert len(shot.obstacles) in (1, 2)


def test_the_road_as_lines(empty_road):
    env = empty_road({"lanes": (3,), "blocks": {"fork": 1.0}, "block_count": 1})
    lines = env.road_polylines()
    assert sum(line.route for line in lines) == 1
    assert sum(line.edge for line in lines) == 2
    assert len(lines) == 4 + 1 + 2 * len(env.scenario.sides)
    left, right = (line.points for line in lines if line.edge)
    assert left[0] == pytest.approx([0.0, 6.0])
    assert right[0] == pytest.approx([0.0, -6.0])


def test_a_picture_shows_the_scene():
    env = make_gym_env(render_mode="rgb_array")
    env.reset(seed=3)
    frame = env.render()
    env.step(FULL)
    assert frame.shape == (450, 900, 3)
    colours = {tuple(colour) for colour in frame.reshape(-1, 3)[::7]}
    assert (50, 200, 0) in colours  # the AV
    assert (200, 0, 150) in colours  # a follower
    assert (255, 255, 255) in colours  # markings
    assert not np.array_equal(frame, env.render())
    env.close()


def test_a_picture_shows_where_the_road_ends_in_a_bend():
    env = make_gym_env(
        {"scenario": {"blocks": {"curve": 1.0}, "traffic_density": 0.0}}, render_mode="rgb_array"
    )
    env.reset(seed=3)
    world = env.unwrapped
    bend = int(np.abs(np.diff(world.scenario.route.heading)).argmax())
    place_av(world, bend + 10.0)
    frame = env.render()
    for side in (-1, 1):
        edge = [world.scenario.route.at(bend + s, side * world.scenario.half_width) for s in (0, 9)]
        for x, y, _ in edge:  # the AV is in the middle of the picture; 4 pixels are a metre
            right, down = 4.0 * (np.array([x, y]) - world.vehicle.position) + [450, 225]
            around = frame[int(down) - 2 : int(down) + 3, int(right) - 2 : int(right) + 3]
            assert (around == 255).all(axis=2).any()
    env.close()


# Forecasts.
def test_a_free_road_threatens_nothing(empty_road):
    env = empty_road(initial_speed=10.0)
    forecast = env.forecast(COAST)
    assert isinstance(env, Forecasting)
    assert (forecast.collision, forecast.departure) == (False, False)
    assert forecast.time_to_collision == forecast.time_to_departure == math.inf
    assert forecast.lateral_acceleration == pytest.approx(0.0, abs=1e-9)
    assert forecast.stalled_steps == 0


def test_a_standing_vehicle_ahead_threatens_a_collision(empty_road, put_vehicle):
    env = empty_road(initial_speed=10.0, forecast_hold=0.6)
    vehicle = put_vehicle(env, 20.0, lane=env.vehicle.lane_index[2])
    # 15 m from bumper to bumper, 3 m of them the margin to what stands still. Driving on for
    # 0.6 s and then braking at 5 m/s² takes 16 m; 12 m are passed after 0.6 s + 0.74 s.
    forecast = env.forecast(COAST)
    assert (forecast.collision, forecast.departure) == (True, False)
    assert forecast.time_to_collision == pytest.approx(1.34, abs=0.21)
    assert not env.forecast(BRAKE).collision  # 8 m/s² for 0.6 s leave enough
    env.road.remove([6])
    assert vehicle not in env.road.vehicles
    put_vehicle(env, 26.0, lane=env.vehicle.lane_index[2])
    assert not env.forecast(COAST).collision
    assert env.forecast(FULL).collision


def test_steering_off_threatens_a_departure(empty_road):
    env = empty_road(initial_speed=10.0)
    forecast = env.forecast(np.array([0.0, 1.0]))
    assert (forecast.collision, forecast.departure) == (False, True)
    assert 0.1 < forecast.time_to_departure < 1.5
    slip = math.atan(math.tan(0.5) / 2)
    assert forecast.lateral_acceleration == pytest.approx(100.0 * math.sin(slip) / 2.5)


def test_a_forecast_changes_nothing(empty_road):
    asked, not_asked = PlatoonEnv(), PlatoonEnv()
    asked.reset(seed=4), not_asked.reset(seed=4)
    for _ in range(30):
        asked.forecast(np.array([1.0, 0.3]))
        a, b = asked.step(FULL), not_asked.step(FULL)
        assert np.array_equal(a[0], b[0])
        assert a[1:4] == b[1:4]


def test_a_forecast_reports_the_stall(empty_road):
    env = empty_road()
    for _ in range(3):
        env.step(COAST)
    assert env.forecast(COAST).stalled_steps == 3


# Interfaces and settings.
def test_gymnasiums_checker_is_content():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it advises bounded observations
        check_env(PlatoonEnv(), skip_render_check=True)


def test_it_is_registered():
    env = gym.make("haim_torchrl/Platoon-v0", config={"followers": 2})
    assert isinstance(env.unwrapped, PlatoonEnv)
    assert env.unwrapped.settings.followers == 2


def test_spaces_fit():
    env = PlatoonEnv()
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert env.action_space.contains(env.action_space.sample())
    assert env.observation_space.shape == (env.settings.observation.size,)


def test_parts_of_the_settings_may_be_mappings():
    env = PlatoonEnv(
        {
            "observation": {"view": "rays", "navigation": [5.0, 10.0]},
            "idm": {"s0": 2.0},
            "scenario": {"lanes": [3]},
        }
    )
    assert env.settings.observation.view == "rays"
    assert env.observation_space.shape == (6 + 4 + 480,)
    assert env.settings.idm.s0 == 2.0
    assert env.scenario.lanes == 3


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"folowers": 5}, r"env: unknown setting 'folowers'; choose from \['end_on_collision'"),
        ({"scenario": {"lane": 2}}, r"env\.scenario: unknown setting 'lane'; choose from"),
        ({"observation": {"ray": 2}}, r"env\.observation: unknown setting 'ray'; choose from"),
        ({"idm": {"gap": 2}}, r"env\.idm: unknown setting 'gap'; choose from"),
        ({"first_scenario": -1}, "first_scenario: must not be negative, got -1"),
        ({"scenarios": 0}, "scenarios: must be at least 1, got 0"),
        ({"followers": 6}, r"followers: must be between \d and 5, got 6"),
        ({"follower_gap": -1.0}, r"follower_gap: must not be negative, got -1\.0"),
        ({"initial_speed": 16.0}, r"initial_speed: must be in \[0, 15\] m/s, got 16\.0"),
        ({"horizon": 0}, "horizon"),
        ({"forecast_braking": 0.0}, r"forecast_braking: must be positive, got 0\.0"),
        ({"forecast_hold": -0.1}, "forecast_hold: must not be negative"),
        ({"simulation_frequency": 15}, "env: unknown setting 'simulation_frequency'"),
    ],
)
def test_contradictions_are_named(settings, words):
    with pytest.raises(ValueError, match=words):
        PlatoonEnv(settings)


def test_settings_of_pictures_pass_through():
    env = PlatoonEnv({"screen_width": 300, "scaling": 2.0})
    assert env.config["screen_width"] == 300
    assert PlatoonConfig.of(None) == PlatoonConfig()
