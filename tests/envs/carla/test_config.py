"""Settings: the files agree with the types, and what cannot work is refused by name."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra

from haim_torchrl.envs.carla import CarlaConfig
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.config import plain

CONF = Path(__file__).parents[3] / "conf"


def test_the_file_shows_all_settings_with_their_defaults():
    register()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        env = plain(compose("haim", ["env=carla"]).env)
    given = {key: value for key, value in env.items() if not key.startswith("_")}
    names = {field.name for field in fields(CarlaConfig)} - {"first_scenario", "scenarios"}
    assert set(given) == names
    assert asdict(CarlaConfig.of(given)) == asdict(CarlaConfig())


def test_seeds_choose_the_town():
    config = CarlaConfig()
    assert [config.town(seed) for seed in (0, 10_000, 19_999)] == ["Town01"] * 3
    assert [config.town(seed) for seed in (20_000, 2**32 - 1)] == ["Town02"] * 2
    for seed in (-1, 2**32):
        with pytest.raises(ValueError, match=rf"scenario {seed} does not exist: Town01 has 0"):
            config.town(seed)


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        ({"scenario": {}}, "unknown setting 'scenario'"),
        ({"observation": {"view": "route"}}, "env/observation=semantic"),
        ({"observation": {"view": "semantic", "rays": 3}}, "rays"),
        ({"idm": {"a": 1}}, "env.idm: unknown setting 'a'"),
        ({"followers": 0}, "followers"),
        ({"followers": 6}, "followers"),
        ({"follower_gap": 1.0}, "follower_gap"),
        ({"horizon": 0}, "horizon"),
        ({"ports": []}, "ports"),
        ({"ports": [60_000]}, "ports"),
        ({"timeout": 0.0}, "timeout"),
        ({"route_length": [300.0, 200.0]}, "route_length"),
        ({"route_length": [20.0, 200.0]}, "route_length"),
        ({"obstacles": []}, "obstacles"),
        ({"obstacles": [0.0]}, "obstacles"),
        ({"traffic": -1}, "traffic"),
        ({"off_route": 0.0}, "off_route"),
        ({"scenarios": 0}, "scenarios"),
        ({"first_scenario": -1}, "first_scenario"),
        ({"first_scenario": 19_990, "scenarios": 20}, "mix Town01 and Town02"),
    ],
)
def test_what_cannot_work_is_refused_by_name(settings, name):
    with pytest.raises(ValueError, match=name):
        CarlaConfig.of(settings)
