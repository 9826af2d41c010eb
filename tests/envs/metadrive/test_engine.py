"""One engine per process, its settings, and what is said when something is missing."""

import importlib.util

import numpy as np
import pytest
from torchrl.envs.utils import check_env_specs

from haim_torchrl.envs.metadrive import MetaDriveConfig, make_env
from haim_torchrl.envs.metadrive.engine import translate


def test_it_is_a_torchrl_environment_with_the_default_worlds_keys(no_engine):
    env = make_env(scenarios=3)
    try:
        check_env_specs(env)
        step = env.rollout(3)
        for key in ("speed", "acceleration", "progress", "cost", "follower_gaps", "success"):
            assert ("next", key) in step.keys(True)
        assert step["observation"].shape[0] == 3
    finally:
        env.close()


def test_a_second_engine_is_refused_until_the_first_is_closed(no_engine):
    first = make_env(scenarios=2)
    simulator = first._env
    with pytest.raises(RuntimeError, match="one engine in a process"):
        make_env(scenarios=2)
    first.close()
    second = make_env(scenarios=2)
    simulator.close()
    second.reset()  # closed once more, the first one leaves the second one's engine alone
    with pytest.raises(RuntimeError, match="is closed; make a new one"):
        simulator.reset()
    second.close()


def test_a_scenario_outside_the_set_is_refused(make_simulator):
    simulator = make_simulator(first_scenario=5)
    with pytest.raises(ValueError, match="scenario 4 is outside this environment's 5 to 14"):
        simulator.reset(seed=4)
    simulator.reset(seed=14)


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match=r"haim-torchrl\[metadrive\]"):
        make_env()


def test_a_window_needs_assets(no_engine, monkeypatch):
    monkeypatch.setattr("haim_torchrl.envs.metadrive.engine._has_assets", lambda: False)
    with pytest.raises(RuntimeError, match=r"pull_asset, or use env\.render=none"):
        make_env(render="3d")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"traffic_density": 1.5}, "traffic_density: must be in"),
        ({"followers": 6}, "followers: must be between 1 and 5"),
        ({"observation": {"view": "camera"}}, "observation.view: choose .rays. or .route."),
        ({"render": "2d"}, "render: choose"),
        ({"max_steering": 0.0}, "max_steering: must be positive"),
        ({"trafic_density": 0.1}, "unknown setting 'trafic_density'"),
        ({"observation": {"laser": 3}}, "unknown setting 'laser'"),
    ],
)
def test_bad_settings_are_named(settings, message):
    with pytest.raises(ValueError, match=message):
        MetaDriveConfig.of(settings)


def test_the_papers_settings_reach_metadrive():
    config = translate(MetaDriveConfig.of({"observation": {"view": "rays"}}))
    assert config["num_scenarios"] == 50
    assert config["map_config"]["config"] == 3
    assert config["traffic_density"] == 0.2
    assert config["accident_prob"] == 0.8
    assert config["horizon"] == 1000
    assert config["vehicle_config"]["lidar"]["num_lasers"] == 240
    assert config["out_of_route_done"]
    assert not config["crash_vehicle_done"]
    # Five followers, 15 m apart and 4.5 m long, fit on the road behind the AV.
    assert config["agent_configs"]["default_agent"]["spawn_longitude"] > 5 * 19.5


def test_memory_stays_flat(make_simulator):
    psutil = pytest.importorskip("psutil")
    simulator, process = make_simulator(), psutil.Process()
    sizes = []
    for episode in range(30):
        simulator.reset(seed=episode % 10)
        simulator.step(np.zeros(2))
        sizes.append(process.memory_info().rss / 2**20)
    assert sizes[-1] - sizes[12] < 40.0  # MiB, over 17 episodes on maps that are all cached
