"""What the agent sees, by hand on a straight road."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from haim_torchrl.envs import ObservationConfig
from haim_torchrl.envs.observation import observe, route_view
from haim_torchrl.envs.path import Piece, arc, draw

SMALL = {"navigation": (5.0, 20.0), "rays": 240}


def seen(env, **settings) -> dict[str, np.ndarray]:
    """The parts of the observation of the present scene."""
    config = ObservationConfig(**{**SMALL, **settings})
    vector = observe(env.road, config)
    assert vector.dtype == np.float32
    assert vector.shape == (config.size,)
    return {name: vector[part] for name, part in config.layout.items()}


def put_av(env, x: float, y: float, heading: float = 0.0, speed: float = 0.0) -> None:
    env.vehicle.position, env.vehicle.heading = np.array([x, y]), heading
    env.vehicle.speed = speed
    env.road.refresh()


def view(x, y, heading, hits, s, middle, path, reach=50.0, borders=(-1.0, 0.0, 1.0), half=4.0):
    """`route_view` of single rays given as angle (in degrees), distance and rate."""
    distances, rates = np.full(360, reach), np.zeros(360)
    for angle, distance, rate in hits:
        distances[angle], rates[angle] = distance, rate
    out = route_view(
        x, y, heading, distances, rates, reach, s, middle,
        path.x, path.y, path.heading, half, 4.0, np.array(borders),
    )  # fmt: skip
    return out.reshape(len(borders) - 1, 4)


def test_the_ego_state_by_hand(empty_road):
    env = empty_road()
    put_av(env, 120.0, 2.5, heading=0.1, speed=7.5)
    expected = [0.5, 4 * math.sin(0.1), 1.625, 0.375, 0.5, -0.5]
    # speed / 15; heading error; 6.5 m and 1.5 m to the edges, by 4; 0.5 m right of the right
    # lane's middle; one lane to the left.
    assert seen(env)["ego"] == pytest.approx(expected, abs=1e-6)
    put_av(env, 120.0, -2.0)
    assert seen(env)["ego"] == pytest.approx([0, 0, 0.5, 1.5, 0, 0.5], abs=1e-6)


def test_beyond_the_edge_the_distance_is_negative(empty_road):
    env = empty_road()
    put_av(env, 120.0, 5.0)
    assert seen(env)["ego"][3] == pytest.approx(-0.25)


def test_navigation_is_in_the_ego_frame(empty_road):
    env = empty_road()
    put_av(env, 120.0, 2.0)
    assert seen(env)["navigation"] == pytest.approx([1.0, 0.0, 1.0, 0.0])
    put_av(env, 120.0, 1.0)  # the lane's middle is 1 m to the right
    assert seen(env)["navigation"] == pytest.approx(
        [1.0, 4 * math.atan2(1, 5), 1.0, 4 * math.atan2(1, 20)], abs=1e-6
    )
    put_av(env, 120.0, 2.0, heading=0.3)  # the road goes off to the left
    assert seen(env)["navigation"][2:] == pytest.approx([math.cos(0.3), -4 * 0.3], abs=1e-6)


def test_rays_as_they_are(empty_road, put_vehicle):
    env = empty_road()
    put_av(env, 200.0, 2.0, speed=6.0)
    put_vehicle(env, 22.5, lane=1, speed=3.0)
    parts = seen(env, view="rays")
    assert list(parts) == ["ego", "navigation", "closeness", "relative_speed"]
    assert parts["closeness"][0] == pytest.approx((1 - 20 / 50) ** 2)
    assert parts["relative_speed"][0] == pytest.approx(-3.0 / 15)
    assert parts["closeness"][100] == 0.0
    plain = seen(env, view="rays", closeness=False, relative_speed=False)
    assert plain["distance"][0] == pytest.approx(20 / 50)
    assert plain["distance"][100] == 1.0
    assert plain["relative_speed"].size == 0


def test_the_papers_observation_has_its_size():
    config = ObservationConfig(view="rays", relative_speed=False, closeness=False)
    assert config.layout["distance"].stop - config.layout["distance"].start == 240


def test_strips_by_hand(empty_road, put_vehicle):
    env = empty_road()
    put_av(env, 200.0, -2.0, speed=6.0)
    put_vehicle(env, 22.5, lane=0, speed=3.0)
    put_vehicle(env, -14.5, lane=1, speed=6.0)
    borders = (-2.0, 0.0, 2.0, 3.5, 4.5)
    strips = seen(env, strips=borders)["strips"].reshape(4, 4)
    ahead, behind = strips[:, :2], strips[:, 2:]
    # A rear 20 m ahead in the own lane, coming nearer at 3 m/s; a front 12 m behind in the lane
    # on the right (the ray that is nearest to its middle meets it less than 0.1 m off).
    assert ahead[1] == pytest.approx([0.36, -0.2], abs=1e-3)
    assert ahead[0] == pytest.approx([0.36, -0.2], abs=1e-3)
    assert (ahead[2:] == 0).all()
    assert behind[3] == pytest.approx([(1 - 12 / 50) ** 2, 0.0], abs=0.01)
    assert (behind[:2] == 0).all()


def test_the_nearest_hit_of_a_strip_counts():
    path = draw([Piece(200.0)])
    hits = [(0, 30.0, -1.5), (1, 10.0, 3.0)]
    strips = view(100.0, 0.0, 0.0, hits, 100.0, 0.0, path)
    along = 10.0 * math.cos(math.radians(1.0))
    assert strips[1, :2] == pytest.approx([(1 - along / 50) ** 2, 0.2])


def test_a_vehicle_round_the_bend_is_in_the_own_lane():
    path = draw([Piece(50.0), arc(30.0, math.pi / 2), Piece(50.0)])
    x, y, _ = path.at(80.0)  # 30 m along the bend, seen from where it begins
    far = math.hypot(x - 50.0, y)
    angle = math.degrees(math.atan2(y, x - 50.0))
    ray = round(angle)
    strips = view(50.0, 0.0, 0.0, [(ray, far, 0.0)], 50.0, 0.0, path, borders=(-1.5, 1.5))
    assert strips[0, 0] == pytest.approx((1 - 30 / 50) ** 2, abs=0.02)
    assert angle > 25  # a straight look would have put it 15 m to the side


def test_a_lane_that_is_not_there_looks_like_a_full_one():
    path = draw([Piece(200.0)])
    # In the right one of two lanes (its middle is 2 m right of the route, the edge 4 m): on the
    # right nothing can be driven on for 4 m; two lanes to the left the road ends, too.
    borders = (-10.0, -6.0, -2.0, 2.0, 6.0, 10.0)
    strips = view(100.0, 2.0, 0.0, [], 100.0, 2.0, path, borders=borders, half=4.0)
    assert strips[:, 0].tolist() == strips[:, 2].tolist() == [1.0, 0.0, 0.0, 1.0, 0.0]
    assert (strips[:, [1, 3]] == 0).all()


@pytest.mark.parametrize("settings", [{"view": "route"}, {"view": "rays"}, {"closeness": False}])
def test_a_mirrored_scene_looks_like_the_reflection_says(empty_road, put_vehicle, settings):
    # The followers are out of sight; no side of a vehicle lies on a border of two strips.
    settings = {"reach": 20.0, "strips": (-6.5, -2.5, -1.5, 0.0, 1.5, 2.5, 6.5), **settings}
    config = ObservationConfig(**settings)
    looks = []
    for side, lane in ((1, 0), (-1, 1)):
        env = empty_road(observation=settings)
        put_vehicle(env, 15.0, lane=lane, speed=3.0)
        put_vehicle(env, -4.0, lane=1 - lane)
        put_av(env, 120.0, 1.3 * side, heading=0.2 * side, speed=6.0)
        looks.append(torch.from_numpy(observe(env.road, config)))
    mirror = env.reflection.observation
    assert not torch.allclose(looks[0], looks[1], atol=0.1)
    # Of the hits on a flat rear, all equally near, the first ray's counts: its rate along the ray
    # depends on the sense of rotation.
    rates = np.zeros(config.size, dtype=bool)
    if "strips" in config.layout:
        rates[config.layout["strips"]][1::2] = True
    for one, other in (looks, looks[::-1]):
        difference = (mirror(one) - other).abs().numpy()
        assert difference[~rates].max() < 1e-5
        assert difference[rates].max(initial=0.0) < 0.05


def test_lopsided_strips_have_no_reflection(empty_road):
    env = empty_road(observation={"strips": (-2.0, 0.0, 5.0)})
    assert env.reflection is None


def test_hits_outside_all_strips_are_left_out():
    path = draw([Piece(200.0)])
    strips = view(100.0, 0.0, 0.0, [(90, 20.0, 0.0)], 100.0, 0.0, path)
    assert (strips == 0).all()


def test_the_copycats_cues_stay_out(empty_road):
    """Neither the last action nor how the AV got into this state can be seen."""
    first, second = empty_road(initial_speed=5.0), empty_road(initial_speed=5.0)
    a, *_ = first.step(np.array([0.0, 0.0]))
    second.step(np.array([-0.7, 0.9]))
    put_av(second, *first.vehicle.position, heading=0.0, speed=5.0)
    second.road.platoon.step(first.vehicle.position, 5.0, second.road.others, 0.1)
    for k, vehicle in enumerate(second.road.platoon.vehicles):
        vehicle.position = first.road.platoon.vehicles[k].position
        vehicle.heading, vehicle.speed = 0.0, first.road.platoon.vehicles[k].speed
    second.road.refresh()
    b = observe(second.road, second.settings.observation)
    assert np.array_equal(a, b)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"rays": 0}, "rays and reach must be positive"),
        ({"reach": 0.0}, "rays and reach must be positive"),
        ({"navigation": (0.0, 5.0)}, r"observation\.navigation: distances ahead must be positive"),
        ({"view": "birdseye"}, r"observation\.view: choose 'rays' or 'route', got 'birdseye'"),
        ({"strips": (1.0, 0.0)}, r"observation\.strips: borders must be increasing"),
        ({"strips": (1.0,)}, r"observation\.strips: borders must be increasing, at least two"),
    ],
)
def test_contradictions_are_named(settings, words):
    with pytest.raises(ValueError, match=words):
        ObservationConfig(**settings)
