"""Five followers drive behind the AV, by the paper's IDM, as bodies in MetaDrive's world."""

import numpy as np
import pytest

from haim_torchrl.mentors.expert import ExpertMentor

GAP, LENGTH, AV_LENGTH = 15.0, 4.6, 4.515


def vehicles(simulator):
    return list(simulator._env.engine.follower_manager.spawned_objects.values())


def test_they_line_up_on_the_road_behind_the_av(free_road):
    _, info = free_road.reset(seed=0)
    np.testing.assert_allclose(info["follower_gaps"], [GAP] * 5, atol=1e-4)
    np.testing.assert_array_equal(info["follower_speeds"], np.zeros(5))
    lane, agent = free_road.agent.lane, free_road.agent
    s, _ = lane.local_coordinates(agent.position)
    for k, vehicle in enumerate(vehicles(free_road), start=1):
        along, aside = lane.local_coordinates(vehicle.position)
        expected = s - k * (GAP + LENGTH) + (LENGTH - AV_LENGTH) / 2
        assert along == pytest.approx(expected, abs=0.01)
        assert aside == pytest.approx(0.0, abs=0.01)
        assert along - LENGTH / 2 > 0.0  # the whole car stands on the lane


def test_the_lasers_see_the_first_one(free_road):
    observation, _ = free_road.reset(seed=0)
    lasers = observation[19:]
    # Straight behind: from the AV's centre to the follower's front, of a range of 50 m.
    assert lasers[120] * 50.0 == pytest.approx(GAP + AV_LENGTH / 2, abs=0.3)
    assert lasers[0] == 1.0


def test_the_first_one_accelerates_by_the_papers_idm(free_road):
    free_road.reset(seed=0)
    for _ in range(30):
        info = free_road.step(np.array([1.0, 0.0]))[-1]
    gap, speed, lead = info["follower_gaps"][0], info["follower_speeds"][0], info["speed"]
    following = free_road.step(np.array([1.0, 0.0]))[-1]
    measured = (following["follower_speeds"][0] - speed) / 0.1
    lead = following["speed"]  # they react to where the AV has gone
    gap = gap + (following["speed"] + info["speed"]) / 2 * 0.1
    wanted = 5.0 + max(0.0, speed * 1.0 + speed * (speed - lead) / (2 * 4.0))
    expected = 4.0 * (1 - (speed / 15.0) ** 4 - (wanted / gap) ** 2)
    assert measured == pytest.approx(expected, abs=0.15)


def test_they_ride_the_trail_of_the_av_through_bends(free_road):
    free_road.reset(seed=1)
    expert = ExpertMentor()
    expert.reset(free_road)
    trail = [free_road.agent.position]
    for _ in range(250):
        *_, terminated, _, info = free_road.step(expert.act(free_road).numpy())
        if terminated:
            break
        trail.append(free_road.agent.position)
    assert (info["follower_gaps"] > 3.0).all()
    path = np.array(trail)
    for vehicle in vehicles(free_road)[:2]:
        away = np.hypot(*(path - np.asarray(vehicle.position)).T).min()
        assert away < 0.8  # samples of the trail are up to 1.1 m apart
    stop = np.array([-1.0, 0.0])
    speeds = [free_road.step(stop)[-1]["follower_speeds"] for _ in range(150)]
    assert (speeds[-1] < 0.5).all()  # the AV stands, and so does everyone behind it


def test_they_leave_with_their_episode(free_road):
    for seed in (0, 1, 0):
        free_road.reset(seed=seed)
        assert len(vehicles(free_road)) == 5
        names = set(free_road._env.engine.get_objects())
        assert {vehicle.name for vehicle in vehicles(free_road)} <= names
