"""Scenarios: what a seed decides, and what settings may ask for."""

from __future__ import annotations

import collections
import itertools

import numpy as np
import pytest

from haim_torchrl.envs import Scenario, ScenarioConfig, generate_scenario
from haim_torchrl.envs.blocks import BLOCKS
from haim_torchrl.envs.scenario import OBSTACLES, RUN_OUT, RUN_UP, START

CONFIG = ScenarioConfig()


@pytest.fixture(scope="module")
def training() -> list[Scenario]:
    """The 50 scenarios of the training set."""
    return [generate_scenario(seed, CONFIG) for seed in range(50)]


def same(a: Scenario, b: Scenario) -> bool:
    paths = all(
        np.array_equal(x.path.x, y.path.x) and np.array_equal(x.path.y, y.path.y)
        for x, y in zip(a.sides, b.sides)
    )
    route = np.array_equal(a.route.x, b.route.x) and np.array_equal(a.route.y, b.route.y)
    drawn = (a.lanes, a.blocks, a.spawns, a.obstacles) == (b.lanes, b.blocks, b.spawns, b.obstacles)
    return paths and route and drawn and len(a.sides) == len(b.sides)


def test_a_seed_gives_one_scenario():
    for seed in (0, 7, 20_003):
        assert same(generate_scenario(seed, CONFIG), generate_scenario(seed, ScenarioConfig()))


def test_another_seed_gives_another_scenario(training):
    held_out = [generate_scenario(seed, CONFIG) for seed in range(20_000, 20_010)]
    for a, b in itertools.combinations([*training[:10], *held_out], 2):
        assert not same(a, b)


def test_the_training_set_has_every_block_and_obstacle_and_both_widths(training):
    blocks = collections.Counter(kind for s in training for kind, _, _ in s.blocks)
    assert set(blocks) == set(BLOCKS)
    assert min(blocks.values()) >= 8
    assert {o.kind for s in training for o in s.obstacles} == set(OBSTACLES)
    assert {s.lanes for s in training} == {2, 3}


def test_blocks_lie_on_the_route_one_after_the_other(training):
    for scenario in training:
        assert len(scenario.blocks) == 3
        ends = [RUN_UP, *(end for _, _, end in scenario.blocks)]
        assert [start for _, start, _ in scenario.blocks] == pytest.approx(ends[:-1])
        assert scenario.route.length == pytest.approx(ends[-1] + RUN_OUT, abs=1.0)


def test_routes_never_come_near_to_themselves(training):
    for scenario in training:
        x, y = scenario.route.x[::2], scenario.route.y[::2]
        gap = np.hypot(x[:, None] - x[None, :], y[:, None] - y[None, :])
        index = 2 * np.arange(len(x))
        far = np.abs(index[:, None] - index[None, :]) > 100
        assert gap[far].min() > 35.0


def test_traffic_enters_ahead_of_the_av_and_not_inside_each_other(training):
    for scenario in training:
        for lane in range(scenario.lanes):
            places = sorted(spawn.s for spawn in scenario.spawns if spawn.lane == lane)
            assert all(s >= START + 25.0 for s in places)
            assert all(b - a >= 14.0 for a, b in itertools.pairwise(places))
        for spawn in scenario.spawns:
            assert (spawn.lane is None) != (spawn.side is None)
            assert 6.0 <= spawn.speed <= 9.0
            for obstacle in scenario.obstacles:
                assert spawn.lane != obstacle.lane or abs(spawn.s - obstacle.s) >= 20.0


def test_obstacles_stand_apart_on_open_road(training):
    counts = collections.Counter(len(s.obstacles) for s in training)
    assert set(counts) <= {0, 1, 2}
    assert counts[1] + counts[2] > 15
    for scenario in training:
        for a, b in itertools.pairwise(scenario.obstacles):
            assert b.s - a.s > 60.0
        for obstacle in scenario.obstacles:
            assert 0 <= obstacle.lane < scenario.lanes
            (kind,) = (k for k, start, end in scenario.blocks if start <= obstacle.s < end)
            assert kind in ("straight", "curve")


def test_the_number_of_obstacles_has_the_given_probabilities():
    config = ScenarioConfig(blocks={"straight": 1.0}, obstacles=(0.0, 0.0, 1.0))
    assert all(len(generate_scenario(seed, config).obstacles) == 2 for seed in range(10))
    none = ScenarioConfig(obstacles=(1.0,))
    assert not any(generate_scenario(seed, none).obstacles for seed in range(10))


def test_weights_choose_blocks_and_obstacles():
    config = ScenarioConfig(
        blocks={"curve": 1.0, "straight": 2.0, "roundabout": 0.0},
        obstacle_kinds={"cones": 1.0, "slow": 0.0},
        obstacles=(0.0, 1.0),
        block_count=2,
    )
    drawn = [generate_scenario(seed, config) for seed in range(20)]
    assert {kind for s in drawn for kind, _, _ in s.blocks} == {"curve", "straight"}
    assert {o.kind for s in drawn for o in s.obstacles} == {"cones"}
    assert all(len(s.blocks) == 2 for s in drawn)


def test_density_sets_the_traffic():
    def on_route(density: float) -> float:
        config = ScenarioConfig(traffic_density=density, side_traffic=0.0, obstacles=(1.0,))
        scenarios = [generate_scenario(seed, config) for seed in range(20)]
        metres = sum(s.lanes * (s.route.length - START - 45.0) for s in scenarios)
        return 100.0 * sum(len(s.spawns) for s in scenarios) / metres

    assert on_route(0.0) == 0.0
    assert on_route(1.0) == pytest.approx(1.0, abs=0.25)
    assert on_route(2.0) == pytest.approx(2.0, abs=0.4)


def test_lanes_by_their_offset():
    scenario = generate_scenario(0, ScenarioConfig(lanes=(3,)))
    assert scenario.half_width == 6.0
    offsets = (-99.0, -5.9, -2.1, -1.9, 0.0, 1.9, 2.1, 99.0)
    assert [scenario.lane_at(d) for d in offsets] == [0, 0, 0, 1, 1, 1, 2, 2]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"blocks": {"bridge": 1.0}}, r"blocks: unknown \['bridge'\]; choose from \['curve'"),
        ({"blocks": {"curve": 0.0}}, "blocks: weights must not be negative, and at least one pos"),
        ({"blocks": {"curve": 1.0, "fork": -1.0}}, "blocks: weights must not be negative"),
        ({"blocks": {}}, "blocks: weights"),
        ({"block_count": 0}, "block_count: must be at least 1, got 0"),
        ({"lanes": (1, 2)}, r"lanes: choose 2 and/or 3, got \[1, 2\]"),
        ({"lanes": ()}, "lanes: choose 2 and/or 3"),
        ({"traffic_density": -1.0}, "traffic_density and side_traffic: must not be negative"),
        ({"traffic_speed": (9.0, 6.0)}, r"traffic_speed: must be two speeds, the lower one first"),
        ({"traffic_speed": (0.0, 6.0)}, r"traffic_speed: .* positive, got \[0\.0, 6\.0\]"),
        ({"obstacles": (0.5, 0.4)}, r"obstacles: probabilities must sum to 1, got \[0\.5, 0\.4\]"),
        ({"obstacles": (1.5, -0.5)}, "obstacles: probabilities"),
        ({"obstacles": ()}, "obstacles: probabilities"),
        ({"obstacle_kinds": {"cow": 1.0}}, r"obstacle_kinds: unknown \['cow'\]; choose from \['co"),
        ({"obstacle_kinds": {"cones": 0.0}}, "obstacle_kinds: weights must not be negative"),
    ],
)
def test_contradictions_are_named(settings, words):
    with pytest.raises(ValueError, match=words):
        ScenarioConfig(**settings)
