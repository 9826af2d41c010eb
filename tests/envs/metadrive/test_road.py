"""What forecast, expert and recordings are told of MetaDrive's road."""

from itertools import pairwise

import numpy as np
import pytest

from haim_torchrl.envs.geometry import HALF_LENGTH, PATH, SPEED
from haim_torchrl.envs.path import Path
from tests.envs.metadrive.test_simulator import FULL, put_barrier


@pytest.mark.parametrize("seed", range(4))
def test_the_carriageway_follows_metadrives_route(free_road, seed):
    free_road.reset(seed=seed)
    navigation, scenario = free_road.agent.navigation, free_road.road.scenario
    assert scenario.lanes == 3
    assert scenario.half_width == 5.25
    # Its length is that of the middle lane of each road.
    graph = navigation.map.road_network.graph
    nodes = navigation.checkpoints
    length = sum(graph[a][b][1].length for a, b in pairwise(nodes))
    assert scenario.route.length == pytest.approx(length, abs=3.0)
    # The middle of the AV's lane is where MetaDrive has it.
    x, y = free_road.agent.position
    assert scenario.lane_at(free_road.road.route_d[0]) == free_road.agent.lane_index[2]
    lane: Path = free_road.road.lanes[free_road.agent.lane_index[2]].path
    assert lane.project((x, -y))[1] == pytest.approx(0.0, abs=0.05)


def test_bodies_come_in_order_and_things_stand(make_simulator):
    simulator = make_simulator()
    simulator.reset(seed=0)
    for _ in range(30):
        simulator.step(np.array([0.6, 0.0]))
    road = simulator.road
    x, y = simulator.agent.position
    np.testing.assert_allclose(road.bodies[0, :2], [x, -y], atol=1e-6)
    assert road.bodies[0, HALF_LENGTH] == pytest.approx(4.515 / 2)
    assert road.followers == 5
    np.testing.assert_allclose(
        road.bodies[1:6, SPEED], simulator._info()["follower_speeds"], rtol=1e-5
    )
    standing = road.others[road.others[:, PATH] < 0]
    assert (standing[:, SPEED] == 0.0).all()
    assert road.predicted().shape == (20, len(road.others), 3)


def test_a_barrier_ahead_is_foreseen(free_road):
    free_road.reset(seed=0)
    for _ in range(25):
        free_road.step(FULL)
    assert not free_road.forecast(FULL).collision
    put_barrier(free_road, 14.0)
    free_road.step(np.array([0.0, 0.0]))
    outlook = free_road.forecast(FULL)
    assert outlook.collision
    assert 0.5 < outlook.time_to_collision < 2.5
    assert not outlook.departure


def test_a_sharp_turn_is_foreseen_to_come_near_the_edge(free_road):
    free_road.reset(seed=0)
    for _ in range(25):
        free_road.step(FULL)
    side = 1.0 if free_road.road.route_d[0] > 0 else -1.0  # towards the nearer edge
    straight, sharp = free_road.forecast(FULL), free_road.forecast(np.array([0.5, side]))
    assert not straight.departure
    assert sharp.lateral_acceleration > 4.0 > straight.lateral_acceleration
    assert sharp.clearance < straight.clearance - 1.0


def test_standing_without_cause_is_stalling(free_road):
    free_road.reset(seed=0)
    counts = []
    for _ in range(25):
        counts.append(free_road.forecast(np.zeros(2)).stalled_steps)
        free_road.step(np.array([-1.0, 0.0]))
    assert counts[-1] >= 20
    for _ in range(30):
        free_road.step(FULL)
    assert free_road.forecast(FULL).stalled_steps == 0


def test_recordings_see_metadrives_frame(make_simulator):
    simulator = make_simulator()
    simulator.reset(seed=0)
    simulator.step(FULL)
    snapshot = simulator.snapshot()
    np.testing.assert_allclose(snapshot.vehicle[:2], simulator.agent.position, atol=1e-6)
    assert snapshot.vehicle[2] == pytest.approx(simulator.agent.heading_theta)
    assert snapshot.followers.shape == (5, 5)
    assert snapshot.followers[0, 0] < snapshot.vehicle[0]
    lines = simulator.road_polylines()
    assert sum(line.route for line in lines) == 1
    assert any(line.edge for line in lines)
    labels = simulator.scenario_labels()
    assert labels.index == 0
    assert len(labels.blocks) == 3
