"""Figures of episodes worked out by hand."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict

from haim_torchrl.evaluation.metrics import (
    EpisodeMeter,
    EpisodeRecord,
    outcome_of,
    steps_of,
    summarise,
)
from haim_torchrl.evaluation.recording import ScenarioLabels


def drive(steps: list[dict[str, float]], labels: ScenarioLabels | None = None) -> EpisodeRecord:
    meter = EpisodeMeter()
    meter.start(labels)
    results = [meter.add(step) for step in steps]
    assert all(result is None for result in results[:-1])
    assert results[-1] is not None
    return results[-1]


def test_one_episode_by_hand() -> None:
    steps = [
        {"speed": 10.0, "reward": 1.0, "intervention": 1.0, "takeover_start": 1.0},
        {"speed": 10.0, "reward": 1.0, "intervention": 1.0},
        {"speed": 8.0, "disturbance": 1.0, "disturbance_onset": 1.0, "disturbance_cost": 0.5},
        {"speed": 6.0, "disturbance": 1.0},
        {"speed": 6.0, "intervention": 1.0, "takeover_start": 1.0, "cost": 1.0},
        {"speed": 10.0, "reward": 20.0, "success": 1.0, "done": 1.0, "progress": 1.0},
    ]
    record = drive(steps, ScenarioLabels(7, ("straight", "curve"), 2))
    assert record.scenario == 7 and record.blocks == ("straight", "curve") and record.obstacles == 2
    assert record.success and record.outcome == "success"
    assert record.steps == 6
    assert record.reward == 22.0
    assert record.distance == pytest.approx(5.0)  # 50 m/s summed, 0.1 s each
    assert record.hard_brakes == 2 and record.hard_brake_onsets == 1
    assert record.disturbance_cost == 0.5
    assert record.mentor_steps == 3
    assert record.takeover_lengths == (2, 1)
    assert record.violations == 1.0
    assert record.progress == 1.0


@pytest.mark.parametrize(
    ("flags", "outcome"),
    [
        ({"success": 1.0}, "success"),
        ({"success": 1.0, "crash": 1.0}, "crash"),
        ({"out_of_road": 1.0}, "out_of_road"),
        ({"wrong_way": 1.0}, "wrong_way"),
        ({"truncated": 1.0}, "timeout"),
        ({"truncated": 1.0, "success": 1.0}, "success"),
        ({}, "other"),
    ],
)
def test_outcomes(flags: dict[str, float], outcome: str) -> None:
    assert outcome_of(flags) == outcome


def test_an_episode_leaves_nothing_to_the_next() -> None:
    meter = EpisodeMeter()
    meter.add({"intervention": 1.0, "cost": 1.0, "done": 1.0})
    record = meter.add({"intervention": 1.0, "done": 1.0})
    assert record is not None
    assert record.takeover_lengths == (1,)
    assert record.violations == 0.0 and record.steps == 1


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_takeover_lengths_add_up_to_the_mentor_steps(flags: list[bool]) -> None:
    steps = [{"intervention": float(flag)} for flag in flags]
    steps[-1]["done"] = 1.0
    record = drive(steps)
    assert sum(record.takeover_lengths) == record.mentor_steps == sum(flags)
    edges = sum(now and not before for before, now in zip([False, *flags], flags))
    assert len(record.takeover_lengths) == edges


def make(steps: int = 100, **fields: object) -> EpisodeRecord:
    return EpisodeRecord(steps=steps, duration=steps / 10, **fields)  # type: ignore[arg-type]


def test_summary_by_hand() -> None:
    records = [
        make(outcome="success", blocks=("straight",), obstacles=0, distance=1000.0, hard_brakes=2,
             hard_brake_onsets=1, reward=300.0, mentor_steps=50, takeover_lengths=(10, 40)),
        make(outcome="crash", blocks=("straight", "fork"), obstacles=1, violations=1.0,
             distance=500.0, hard_brakes=4, hard_brake_onsets=2, reward=100.0),
        make(steps=200, outcome="timeout", blocks=("fork",), obstacles=2, distance=500.0),
        make(outcome="success", blocks=("curve",), obstacles=0, distance=1000.0, reward=200.0,
             mentor_steps=30, takeover_lengths=(30,)),
    ]  # fmt: skip
    summary = summarise(records)
    overall = {name: estimate.value for name, estimate in summary.overall.items()}
    assert overall["success"] == 0.5
    assert overall["violations"] == 0.25
    assert overall["return"] == 150.0
    assert overall["disturbance_rate"] == pytest.approx(6 / 500)
    assert overall["disturbance_onsets_per_km"] == pytest.approx(1.0)  # 3 onsets on 3 km
    assert overall["takeover_rate"] == pytest.approx(80 / 500)
    assert overall["takeovers"] == 0.75
    assert overall["takeover_length_median"] == 30.0
    assert overall["crash"] == 0.25 and overall["timeout"] == 0.25
    assert overall["speed"] == pytest.approx(3000.0 / 50.0)
    blocks = {name: (e.value, e.count) for name, e in summary.success_by_block.items()}
    assert blocks == {"curve": (1.0, 1), "fork": (0.0, 2), "straight": (0.5, 2)}
    obstacles = {name: (e.value, e.count) for name, e in summary.success_by_obstacles.items()}
    assert obstacles == {"with": (0.0, 2), "without": (1.0, 2)}
    assert summary.outcomes == {"success": 2, "crash": 1, "timeout": 1}


def test_summary_without_takeovers_has_no_median_length() -> None:
    summary = summarise([make(outcome="success")])
    assert math.isnan(summary.overall["takeover_length_median"].value)
    assert summary.as_dict()["overall"]["takeover_length_median"]["value"] is None


def test_no_episode_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one"):
        summarise([])


def test_steps_of_reads_who_drove_from_next_or_root() -> None:
    flags = torch.tensor([[[True], [False]], [[False], [True]]])
    following = TensorDict({"done": flags, "reward": torch.ones(2, 2, 1)}, batch_size=[2, 2])
    at_root = TensorDict({"intervention": flags, "next": following.clone()}, batch_size=[2, 2])
    steps = steps_of(at_root)
    assert [[step["intervention"] for step in row] for row in steps] == [[1.0, 0.0], [0.0, 1.0]]
    # In the environment's own form the root holds the flag of the step before.
    at_next = at_root.clone()
    at_next["next", "intervention"] = ~flags
    assert [[step["intervention"] for step in row] for row in steps_of(at_next)] == [
        [0.0, 1.0],
        [1.0, 0.0],
    ]
