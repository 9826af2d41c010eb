"""Image and speed as the observation of a simulator: of a scene by hand, and of the world."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from haim_torchrl.envs import PlatoonEnv, make_env
from haim_torchrl.envs.semantic import RoadLayers, SemanticConfig, SemanticObserver, SemanticRaster
from haim_torchrl.evaluation.recording import Snapshot

VEHICLES, OBSTACLES = 2, 3
METRE = SemanticConfig(size=60, reach=40.0, behind=20.0)


def box(x: float, y: float) -> np.ndarray:
    return np.array([[x, y, 0.0, 4.0, 2.0]])


def world(**observation: object) -> PlatoonEnv:
    return PlatoonEnv({"observation": {"view": "semantic", "size": 42, **observation}})


def test_a_scene_by_hand():
    """Follower behind, traffic ahead on the left, obstacle ahead on the right; 7.5 m/s."""
    eyes = SemanticObserver(METRE)
    eyes.reset(RoadLayers())
    scene = Snapshot(
        time=0.0,
        vehicle=np.array([100.0, 50.0, 0.0, 5.0, 2.0]),
        speed=7.5,
        acceleration=0.0,
        followers=box(90.0, 50.0),
        traffic=box(120.0, 54.0),
        obstacles=box(110.0, 46.0),
    )
    seen = eyes.observe(scene)
    assert eyes.space.contains(seen)
    assert seen["state"].tolist() == [0.5]
    expected = np.zeros((5, 60, 60))
    expected[VEHICLES, 48:52, 29:31] = 255  # 10 m behind
    expected[VEHICLES, 18:22, 25:27] = 255  # 20 m ahead, 4 m to the left
    expected[OBSTACLES, 28:32, 33:35] = 255
    np.testing.assert_array_equal(seen["pixels"], expected)


def test_there_is_nothing_to_see_before_the_first_road():
    with pytest.raises(RuntimeError, match="no road to look at"):
        SemanticObserver(METRE).observe(Snapshot(0.0, np.zeros(5), 0.0, 0.0))


def test_the_world_offers_image_and_speed():
    env = make_env(observation={"view": "semantic", "size": 42})
    check_env_specs(env)
    rollout = env.rollout(3)
    assert rollout["pixels"].shape == (3, 5, 42, 42)
    assert rollout["pixels"].dtype == torch.uint8
    torch.testing.assert_close(rollout["next", "state"], rollout["next", "speed"] / 15)
    assert "observation" not in rollout.keys(True)


def test_where_the_vehicle_starts_it_sees_the_road_and_its_followers():
    """It stands on the route, on the straight that every scenario begins with."""
    env = world(size=60)  # pixels of a metre
    seen, _ = env.reset(seed=3)
    pixels = seen["pixels"]
    half = env.scenario.half_width
    d = env.scenario.route.project(env.vehicle.position)[1]
    for channel in ("road", "route"):
        row = pixels[("road", "lane", "vehicles", "obstacles", "route").index(channel), 39]
        assert row.sum() / 255 == pytest.approx(2 * half, abs=0.6)
        centre = (row * (np.arange(60) + 0.5)).sum() / row.sum()
        assert 30 - centre == pytest.approx(d, abs=0.3)  # the middle is to the left by d
    gap = env.road.platoon.gaps[0]
    rows = np.nonzero(pixels[VEHICLES, 40:, 30])[0]
    assert rows.min() == pytest.approx(2.5 + gap, abs=1.0)  # its own half length, then the gap


def test_a_mirrored_world_is_a_mirrored_image():
    """The AV at y and at -y on a straight road that looks the same from both sides."""
    looks = []
    for side in (1.0, -1.0):
        env = PlatoonEnv(
            {
                "observation": {"view": "semantic", "size": 42},
                "scenario": {"blocks": {"straight": 1.0}, "lanes": (2,), "obstacles": (1.0,)},
            }
        )
        env.reset(seed=0)
        pose = (120.0, -1.3 * side, -0.2 * side)  # y to the left
        box = np.array([[140.0, -5.0 * side, 0.1 * side, 4.5, 2.0]])
        raster = SemanticRaster(SemanticConfig(size=42), env.road_layers())
        looks.append(torch.from_numpy(raster.draw(pose, box, box)).int())
    mirrored = env.reflection.image(looks[0])
    assert (mirrored - looks[1])[[VEHICLES, OBSTACLES]].abs().max() <= 1
    # Edges of the road lie as they fall on the map's pixels, a quarter as wide as the image's.
    assert (mirrored - looks[1]).abs().float().mean() < 5.0
    assert (looks[0] - looks[1]).abs().float().mean() > 20.0


def test_settings_of_the_view():
    env = world(reach=30.0, behind=10.0)
    assert env.settings.observation == SemanticConfig(42, 30.0, 10.0)
    with pytest.raises(ValueError, match="choose it with env/observation=semantic"):
        world(rays=240)
    with pytest.raises(ValueError, match="reach: must be positive"):
        world(reach=-1.0)
    assert SemanticConfig.of({"view": "rays", "rays": 240}) is None
