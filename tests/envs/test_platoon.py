"""The followers: IDM by its formula, and the AV's trail through turns and lane changes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.envs.geometry import COLUMNS
from haim_torchrl.envs.path import Path, Piece, arc, draw
from haim_torchrl.envs.platoon import Platoon
from haim_torchrl.traffic import IDMParameters, idm_acceleration

PARAMS = IDMParameters()
RUN_UP = draw([Piece(115.0)])
NOBODY = np.zeros((0, COLUMNS))
LENGTH = 5.0


def make(count: int = 5, gap: float = 15.0, speed: float = 0.0) -> Platoon:
    return Platoon(RUN_UP, count, gap, speed, PARAMS)


def lead(platoon: Platoon, path: Path, speed: float, others: np.ndarray = NOBODY) -> np.ndarray:
    """Lead the platoon along a path at a constant speed; returns where the AV was, [T, 2]."""
    driven = [path.at(0.0)[:2]]
    for s in np.arange(speed * 0.1, path.length, speed * 0.1):
        driven.append(path.at(s)[:2])
        platoon.step(np.array(driven[-1]), speed, others, 0.1)
    return np.array(driven)


def distance_to(points: np.ndarray, x: float, y: float) -> float:
    """Distance of a place from a polyline [m]."""
    a, b = points[:-1], points[1:]
    along = b - a
    share = ((np.array([x, y]) - a) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12)
    foot = a + np.clip(share, 0, 1)[:, None] * along
    return float(np.hypot(*(foot - [x, y]).T).min())


def test_they_start_behind_the_av_at_equal_gaps():
    platoon = make(3)
    assert platoon.gaps.tolist() == [15.0] * 3
    assert [v.position[0] for v in platoon.vehicles] == pytest.approx([95.0, 75.0, 55.0])
    assert platoon.speeds.tolist() == [0.0] * 3


def test_each_drives_by_idm_behind_its_predecessor():
    platoon = make(3, gap=20.0, speed=8.0)
    before, gaps = platoon.speeds.copy(), np.array([20.5, 20.0, 20.0])
    platoon.step(np.array([115.5, 0.0]), 5.0, NOBODY, 0.1)
    expected = idm_acceleration(
        torch.tensor(before), torch.tensor(gaps), torch.tensor([5.0, 8.0, 8.0]), PARAMS
    )
    assert platoon.accelerations == pytest.approx(expected.numpy())
    assert platoon.speeds == pytest.approx(before + 0.1 * expected.numpy())
    way = 0.1 * (before + platoon.speeds) / 2
    assert platoon.gaps[0] == pytest.approx(20.5 - way[0])
    assert platoon.gaps[1] == pytest.approx(20.0 + way[0] - way[1])


def test_speeds_given_as_whole_numbers_do_no_harm():
    platoon = make(2, gap=15, speed=5)
    platoon.step(np.array([115.5, 0.0]), 5.0, NOBODY, 0.1)
    assert platoon.speeds[0] != round(platoon.speeds[0])


@pytest.mark.parametrize("turn", [math.pi / 2, -math.pi / 2])
def test_they_take_the_turns_of_the_av(turn):
    platoon = make()
    path = draw([Piece(20.0), arc(12.0, turn), Piece(150.0)], (115.0, 0.0, 0.0))
    driven = np.concatenate([np.stack([RUN_UP.x, RUN_UP.y], 1), lead(platoon, path, 6.0)])
    for vehicle in platoon.vehicles:
        assert distance_to(driven, *vehicle.position) < 0.05
        assert vehicle.heading == pytest.approx(turn, abs=0.01)  # round the corner, all of them
    assert platoon.gaps.max() < 20.0


def test_they_change_lanes_with_the_av():
    platoon = make()
    s = np.linspace(0.0, 150.0, 151)
    y = 2.0 * (1 - np.cos(np.pi * np.clip((s - 20) / 40, 0, 1)))
    path = Path.through(115.0 + s, y)
    trails = {k: [] for k in range(5)}
    driven = [np.stack([RUN_UP.x, RUN_UP.y], 1)]
    for s_av in np.arange(0.7, path.length, 0.7):
        driven.append(np.array([path.at(s_av)[:2]]))
        platoon.step(driven[-1][0], 7.0, NOBODY, 0.1)
        for k, vehicle in enumerate(platoon.vehicles):
            trails[k].append(vehicle.position.copy())
    line = np.concatenate(driven)
    for trail in trails.values():
        assert max(distance_to(line, *place) for place in trail[:: len(trail) // 20]) < 0.3
    assert platoon.vehicles[0].position[1] == pytest.approx(4.0, abs=0.01)


@given(st.lists(st.floats(0.0, 15.0), min_size=5, max_size=30), st.floats(0.0, 15.0))
@settings(max_examples=40, deadline=None)
def test_gaps_are_never_negative(speeds, start):
    """Whatever the AV does, even stopping dead from any speed."""
    platoon = make(gap=6.0, speed=start)
    x = 115.0
    for speed in np.repeat(speeds, 5):
        x += speed * 0.1
        platoon.step(np.array([x, 0.0]), speed, NOBODY, 0.1)
        assert platoon.gaps.min() >= -1e-9
        assert platoon.speeds.min() >= 0.0
        assert platoon.speeds.max() <= 15.0


def test_behind_a_standing_av_they_stop_at_the_standstill_gap():
    platoon = make(gap=40.0, speed=10.0)
    for _ in range(600):
        platoon.step(np.array([115.0, 0.0]), 0.0, NOBODY, 0.1)
    assert platoon.speeds == pytest.approx(np.zeros(5), abs=0.05)
    assert platoon.gaps == pytest.approx(np.full(5, PARAMS.s0), abs=0.5)


def test_what_stands_on_the_trail_stops_them(body):
    platoon = make(2, gap=15.0)
    blocker = np.array([body(105.0, 0.0)])  # between the AV and the first follower
    path = draw([Piece(150.0)], (115.0, 0.0, 0.0))
    lead(platoon, path, 8.0, blocker)
    first, second = platoon.vehicles
    assert first.position[0] + LENGTH / 2 < 105.0 - LENGTH / 2
    assert first.speed < 0.1
    assert second.position[0] < first.position[0] - LENGTH
    assert platoon.gaps[0] > 100.0  # the gap to the AV, which is gone


@pytest.mark.parametrize("place", [(105.0, 2.5), (125.0, 0.0), (20.0, 0.0)])
def test_what_stands_elsewhere_does_not(body, place):
    """Beside the trail, before the AV, behind the platoon."""
    free, other = make(2), make(2)
    for k in range(1, 8):
        position = np.array([115.0 + 0.8 * k, 0.0])
        free.step(position, 8.0, NOBODY, 0.1)
        other.step(position, 8.0, np.array([body(*place)]), 0.1)
    assert np.array_equal(free.gaps, other.gaps)


def test_a_slow_vehicle_on_the_trail_is_followed(body):
    platoon = make(1, gap=30.0, speed=5.0)
    x_av, x_other = 115.0, 100.0
    for _ in range(300):
        x_av, x_other = x_av + 1.0, x_other + 0.3
        platoon.step(np.array([x_av, 0.0]), 10.0, np.array([body(x_other, 0.0, speed=3.0)]), 0.1)
    assert platoon.speeds[0] == pytest.approx(3.0, abs=0.1)
    # IDM's equilibrium gap at 3 m/s: (s0 + v T) / sqrt(1 - (v / v0)^4) = 8.006 m, before the
    # follower's own step of 0.3 m.
    gap = x_other - platoon.vehicles[0].position[0] - LENGTH
    assert gap == pytest.approx(8.006 - 0.3, abs=0.02)


def test_a_trail_may_be_kilometres_long():
    platoon = make(1, speed=15.0)
    for k in range(1, 3000):
        platoon.step(np.array([115.0 + 1.4 * k, 0.0]), 14.0, NOBODY, 0.1)
    assert platoon.trail_length == pytest.approx(115.0 + 1.4 * 2999)
    assert platoon.vehicles[0].position[1] == 0.0
    assert 10.0 < platoon.gaps[0] < 40.0


def test_a_standing_av_leaves_no_trail():
    platoon = make(1)
    for _ in range(5):
        platoon.step(np.array([115.0, 0.0]), 0.0, NOBODY, 0.1)
    assert platoon.trail_length == 115.0
