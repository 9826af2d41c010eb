"""The rule-based expert: alone on unseen roads, and its single decisions by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from haim_torchrl.envs import PlatoonEnv
from haim_torchrl.envs.vehicles import StoppedVehicle
from haim_torchrl.mentors import Mentor
from haim_torchrl.mentors.expert import ExpertMentor

EMPTY = {
    "blocks": {"straight": 1.0},
    "traffic_density": 0.0,
    "side_traffic": 0.0,
    "obstacles": (1.0,),
    "lanes": (2,),
}


def world(speed: float = 10.0, lane: int = 0, **scenario) -> PlatoonEnv:
    env = PlatoonEnv({"scenario": EMPTY | scenario, "initial_speed": speed})
    env.reset(seed=0)
    x, y, heading = env.road.lanes[lane].path.at(120.0)
    env.vehicle.position, env.vehicle.heading = np.array([x, y]), heading
    env.road.refresh()
    return env


def put(env: PlatoonEnv, ahead: float, lane: int, speed: float = 0.0) -> StoppedVehicle:
    s = float(env.road.route_s[0]) + ahead
    vehicle = StoppedVehicle(env.road, ("start", "destination", lane), s, speed)
    env.road.vehicles.append(vehicle)
    env.road.refresh()
    return vehicle


def drive(env: PlatoonEnv, steps: int = 1000) -> tuple[dict, list[np.ndarray], list[float]]:
    """Let the expert drive on: last info, its actions, and its offsets from the route [m]."""
    expert = ExpertMentor()
    expert.reset(env)
    actions, offsets = [], []
    for _ in range(steps):
        actions.append(expert.act(env).numpy())
        *_, terminated, truncated, info = env.step(actions[-1])
        offsets.append(float(env.road.route_d[0]))
        if terminated or truncated:
            break
    return info, actions, offsets


def decide(env: PlatoonEnv) -> torch.Tensor:
    expert = ExpertMentor()
    expert.reset(env)
    return expert.act(env)


@pytest.mark.parametrize(
    "kind", ["straight", "curve", "ramp", "fork", "t_junction", "intersection", "roundabout"]
)
def test_it_arrives_on_every_kind_of_block(kind):
    """On held-out scenarios, with traffic and obstacles, in good time and without a collision."""
    env = PlatoonEnv({"scenario": {"blocks": {kind: 1.0, "straight": 0.5}}})
    for seed in (10_000, 10_001, 10_002):
        env.reset(seed=seed)
        info, actions, _ = drive(env)
        assert info["success"], (seed, info)
        assert len(actions) < 700


def test_its_actions_are_actions():
    env = world()
    expert = ExpertMentor()
    assert isinstance(expert, Mentor)
    expert.reset(env)
    action = expert.act(env, None)
    assert action.shape == (2,)
    assert action.dtype == torch.float32
    assert (action.abs() <= 1.0).all()


def test_it_reaches_its_speed_and_keeps_it():
    env = world(speed=0.0)
    assert decide(env)[0] > 0.4
    drive(env, 150)
    assert env.vehicle.speed == pytest.approx(11.1, abs=0.2)
    env.vehicle.speed = 14.0
    assert decide(env)[0] < -0.2


def test_it_keeps_to_the_middle_of_its_lane():
    _, actions, offsets = drive(world(lane=1), 100)
    assert offsets == pytest.approx([2.0] * 100, abs=0.01)
    assert max(abs(action[1]) for action in actions) < 0.01


def test_it_slows_down_for_bends():
    env = world(speed=11.0, blocks={"roundabout": 1.0})
    speeds = []
    expert = ExpertMentor()
    expert.reset(env)
    for _ in range(300):
        *_, terminated, _, _ = env.step(expert.act(env).numpy())
        speeds.append(env.vehicle.speed)
        if terminated:
            break
    assert min(speeds) < 7.5  # 2.5 m/s² on a radius of 18 m are 6.7 m/s
    assert max(speeds) > 10.0


def test_it_follows_a_slow_vehicle_where_it_cannot_pass():
    env = world()
    leader, beside = put(env, 30.0, 0, 4.0), put(env, 30.0, 1, 4.0)
    drive(env, 150)
    assert env.vehicle.speed == pytest.approx(4.0, abs=0.3)
    gap = leader.position[0] - env.vehicle.position[0] - 5.0
    assert 5.0 < gap < 13.0
    assert beside.position[0] - env.vehicle.position[0] > 5.0


def test_it_passes_a_slow_vehicle_where_it_can():
    env = world()
    slow = put(env, 40.0, 0, 2.5)
    info, _, offsets = drive(env, 120)
    assert not info["crash"]
    assert env.vehicle.position[0] > slow.position[0] + 10.0
    assert offsets[-1] == pytest.approx(2.0, abs=0.3)


def test_it_does_not_cut_in():
    """A faster vehicle comes from behind in the other lane."""
    env = world(speed=6.0)
    put(env, 30.0, 0, 2.5)
    put(env, -8.0, 1, 10.0)
    assert abs(decide(env)[1]) < 0.02
    env = world(speed=6.0)
    put(env, 30.0, 0, 2.5)
    put(env, -40.0, 1, 6.0)
    assert decide(env)[1] > 0.02  # to the right


def test_it_stops_where_every_lane_is_closed():
    env = world()
    put(env, 60.0, 0)
    put(env, 60.0, 1)
    info, actions, _ = drive(env, 200)
    assert not info["crash"]
    assert env.vehicle.speed < 0.2
    assert min(action[0] for action in actions) > -0.9  # gently
    ahead = 180.0 - env.vehicle.position[0] - 5.0
    assert 3.0 < ahead < 12.0


def test_it_brakes_as_hard_as_it_must():
    env = world(speed=12.0)
    put(env, 16.0, 0)
    put(env, 16.0, 1)
    assert decide(env)[0] == pytest.approx(-1.0)


def test_it_comes_back_after_somebody_else_has_driven():
    env = world(lanes=(3,), lane=0)
    expert = ExpertMentor()
    expert.reset(env)
    expert.act(env)
    x, y, heading = env.road.lanes[2].path.at(150.0)
    env.vehicle.position, env.vehicle.heading = np.array([x, y]), heading
    env.road.refresh()
    assert abs(expert.act(env)[1]) < 0.01  # stays in the lane that it finds itself in


def test_looking_on_changes_nothing():
    asked, alone = PlatoonEnv(), PlatoonEnv()
    asked.reset(seed=3), alone.reset(seed=3)
    expert = ExpertMentor()
    expert.reset(asked)
    for _ in range(40):
        expert.act(asked)
        step = np.array([0.5, 0.0])
        assert np.array_equal(asked.step(step)[0], alone.step(step)[0])
