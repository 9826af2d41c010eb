"""What a seed stands for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.envs.carla import CarlaConfig
from haim_torchrl.envs.carla.map.town import Town
from haim_torchrl.envs.carla.scenario import CLEAR, PROPS, ROOM, draw_scenario

pytest.importorskip("carla")


@pytest.fixture(scope="module")
def town(town_map):
    return Town(town_map)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_every_seed_has_a_scenario_with_room(town, seed):
    config = CarlaConfig(obstacles=(0.0, 0.5, 0.5))
    scenario = draw_scenario(town, seed, config)
    path = scenario.route.path
    assert scenario.town == config.town(seed)
    assert scenario.start == 5 * (15 + 5) + 5
    assert 150.0 <= path.length - scenario.start <= 400.0
    assert 1 <= len(scenario.obstacles) <= 2
    for name, pose in scenario.obstacles:
        s, d = path.project(pose[:2])
        assert name in PROPS
        assert d == pytest.approx(1.8, abs=0.05)
        assert scenario.start + CLEAR - 1 <= s <= path.length - CLEAR + 1
    platoon = np.stack([path.x, path.y], axis=1)[: int(scenario.start)]
    assert len(scenario.places) > 20
    for pose in scenario.places:
        assert np.hypot(*(platoon - pose[:2]).T).min() > ROOM


def test_the_same_seed_is_the_same_scenario(town):
    config = CarlaConfig()
    one, again, other = (draw_scenario(town, seed, config) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.route.path.x, again.route.path.x)
    assert (one.obstacles, one.places) == (again.obstacles, again.places)
    assert one.route.keys != other.route.keys or one.places != other.places


def test_obstacles_come_as_often_as_asked(town):
    config = CarlaConfig(obstacles=(0.25, 0.75))
    counts = [len(draw_scenario(town, seed, config).obstacles) for seed in range(200)]
    assert set(counts) == {0, 1}
    assert 0.65 < np.mean(counts) < 0.85  # 0.75 with a standard error of 0.03


def test_a_seed_out_of_range(town):
    with pytest.raises(ValueError, match="scenario -1 does not exist"):
        draw_scenario(town, -1, CarlaConfig())
