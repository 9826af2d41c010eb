"""Evaluation on a world whose episodes are known in advance."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from haim_torchrl.data.demonstrations import record_demonstrations
from haim_torchrl.evaluation.drivers import (
    PolicyDriver,
    RandomDriver,
    StraightDriver,
    simulator_of,
)
from haim_torchrl.evaluation.evaluator import drive_episode, evaluate
from haim_torchrl.modules import make_actor
from haim_torchrl.switches import RiskSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform


def with_mentor(road: Any, mentor: Any, switch: Any) -> EnvBase:
    env = TransformedEnv(road())
    env.append_transform(InterventionTransform(mentor, switch))
    env.append_transform(DisturbanceTransform())
    return env


def test_the_world_keeps_its_specs(toy_road: Any) -> None:
    check_env_specs(toy_road())


def test_straight_ahead_hits_the_obstacle_of_odd_scenarios(toy_road: Any) -> None:
    result = evaluate(StraightDriver(), toy_road, [0, 1, 2, 3])
    assert [record.outcome for record in result.records] == ["success", "crash"] * 2
    assert [record.scenario for record in result.records] == [0, 1, 2, 3]
    assert [record.steps for record in result.records] == [20, 10, 20, 10]
    assert [record.reward for record in result.records] == [40.0, 10.0, 40.0, 10.0]
    assert [record.violations for record in result.records] == [0.0, 1.0, 0.0, 1.0]
    assert result.records[0].distance == pytest.approx(20.0)
    assert result.records[0].progress == pytest.approx(1.0)
    summary = result.summary()
    assert summary.overall["success"].value == 0.5
    assert summary.success_by_obstacles["with"].value == 0.0


def test_a_mentor_is_a_driver(toy_road: Any, toy_mentor: Any) -> None:
    result = evaluate(toy_mentor(), toy_road, [1, 3, 5])
    assert all(record.success for record in result.records)
    assert all(record.mentor_steps == 0 for record in result.records)


def test_time_out(toy_road: Any) -> None:
    record, _ = drive_episode(toy_road(horizon=5), StraightDriver(), 0)
    assert record.outcome == "timeout" and record.steps == 5


def test_a_mentor_in_the_environment_takes_over_from_the_driver(
    toy_road: Any, toy_mentor: Any
) -> None:
    class Sideways(StraightDriver):
        def __init__(self) -> None:
            self._action = torch.tensor([0.0, 1.0])

    alone = evaluate(Sideways(), toy_road, [0]).records[0]
    assert alone.outcome == "out_of_road" and alone.steps == 3
    helped = evaluate(
        Sideways(), partial(with_mentor, toy_road, toy_mentor, RiskSwitch), [0], record=[0]
    )
    record = helped.records[0]
    # Aside by 1, 2, then the third metre is forbidden and the mentor steers back to 1, and so on.
    assert record.success and record.steps == 20
    assert record.takeover_lengths == (1,) * 9 and record.mentor_steps == 9
    assert helped.episodes[0].interventions[:4] == [False, False, True, False]


def test_hard_braking_is_counted_without_a_mentor(toy_road: Any) -> None:
    def make() -> EnvBase:
        return TransformedEnv(toy_road(), DisturbanceTransform())

    record = evaluate(StraightDriver(acceleration=-1.0), make, [0]).records[0]
    assert record.hard_brakes == 20 and record.hard_brake_onsets == 1
    assert 0.0 < record.disturbance_cost < 1.0


def test_the_policy_drives_deterministically(toy_road: Any) -> None:
    torch.manual_seed(0)
    driver = PolicyDriver(make_actor(3, 2, hidden=(8,)))
    first, second = (evaluate(driver, toy_road, [1], record=[1]) for _ in range(2))
    assert (first.episodes[0].trail == second.episodes[0].trail).all()


def test_random_drives_differ_between_episodes_but_not_between_runs(toy_road: Any) -> None:
    first, second = (
        evaluate(RandomDriver(seed=3), toy_road, [0, 0], record=[0]).episodes for _ in range(2)
    )
    assert (first[0].trail == second[0].trail).all()
    assert first[0].trail[1].tolist() != first[1].trail[1].tolist()


def test_recording_has_one_scene_more_than_steps(toy_road: Any) -> None:
    result = evaluate(StraightDriver(), toy_road, [0, 1], record=[1])
    assert len(result.episodes) == 1
    episode = result.episodes[0]
    assert len(episode) == 10 and len(episode.snapshots) == 11
    assert len(episode.interventions) == 10
    assert episode.outcome == "crash" and episode.labels.index == 1
    # Followers 10 m apart, 5 m long, behind a leader at x = 0 then 10.
    assert episode.positions()[0].tolist() == [0.0, -15.0, -30.0]
    assert episode.positions()[-1].tolist() == pytest.approx([10.0, -5.0, -20.0])


def test_progress_is_reported(toy_road: Any) -> None:
    seen: list[int] = []
    evaluate(
        StraightDriver(), toy_road, [4, 2], on_episode=lambda record: seen.append(record.scenario)
    )
    assert seen == [4, 2]


@pytest.mark.parametrize(
    ("scenarios", "workers", "word"), [([], 1, "scenario"), ([1], 0, "workers")]
)
def test_bad_input(toy_road: Any, scenarios: list[int], workers: int, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        evaluate(StraightDriver(), toy_road, scenarios, workers=workers)


def test_several_simulators_are_refused(toy_road: Any) -> None:
    with pytest.raises(TypeError, match="several"):
        simulator_of(SerialEnv(2, toy_road))


def test_demonstrations_hold_what_the_mentor_saw_and_did(toy_road: Any, toy_mentor: Any) -> None:
    data = record_demonstrations(toy_road, toy_mentor(), 50, [1, 3], seed=0)
    assert data.shape == (50,) and data["observation"].shape == (50, 3)
    assert data["next", "done"].sum() == 2  # 20 steps an episode
    starts = data["observation"][:, 0] == 0.0
    assert data["action"][starts, 1].tolist() == [1.0, 1.0, 1.0]
    assert data["action"][~starts, 1].abs().max() == 0.0
    assert torch.equal(data["takeover_start"].squeeze(-1), starts) and data["intervention"].all()
    for key in ("action_agent", "action_mentor"):
        assert torch.equal(data[key], data["action"])
    going_on = ~data["next", "done"][:-1].squeeze(-1)
    following = data["next", "observation"][:-1][going_on]
    assert torch.equal(following, data["observation"][1:][going_on])


def test_demonstrations_visit_every_scenario_before_any_again(
    toy_road: Any, toy_mentor: Any
) -> None:
    seen: list[int] = []

    class Watching(toy_mentor):  # type: ignore[misc]
        def reset(self, simulator: Any) -> None:
            seen.append(simulator.scenario)

    record_demonstrations(toy_road, Watching(), 120, [0, 1, 2], seed=1)
    assert sorted(seen[:3]) == [0, 1, 2] and sorted(seen[3:6]) == [0, 1, 2]


def test_a_policy_that_reads_another_key(toy_road: Any) -> None:
    steer = TensorDictModule(lambda x: torch.cat([x * 0, x * 0]), ["progress"], ["action"])
    assert evaluate(PolicyDriver(steer), toy_road, [0]).records[0].success
