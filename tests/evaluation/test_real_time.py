"""Durations of steps, with figures worked out by hand."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.evaluation.real_time import StepTimes


def batch(seconds, ok=None, shape=None):
    """Transitions as a paced environment publishes them."""
    times = torch.tensor(seconds)
    works = torch.ones_like(times, dtype=torch.bool) if ok is None else torch.tensor(ok)
    shape = list(times.shape) if shape is None else shape
    entries = {"step_time": times.reshape(*shape, 1), "device_ok": works.reshape(*shape, 1)}
    return TensorDict({"next": TensorDict(entries, shape)}, shape)


def test_figures_by_hand():
    times = StepTimes(pace=10.0)
    times.add(batch([0.0, 0.10, 0.12, 0.20], [True, False, True, False]))
    times.add(batch([0.0, 0.10]))  # a pause, or another episode
    # Four steps: 0.10, 0.10, 0.12, 0.20. Quantiles lie at 1.5, 2.85 and 2.97 between them.
    assert times.figures() == pytest.approx(
        {
            "step_ms_p50": 110.0,
            "step_ms_p95": 120.0 + 0.85 * 80.0,
            "step_ms_p99": 120.0 + 0.97 * 80.0,
            "step_ms_max": 200.0,
            "steps_timed": 4.0,
            "deadlines_missed": 2.0,  # more than a tenth late: 0.12 and 0.20
            "device_failed_steps": 2.0,
        },
        rel=1e-6,
    )
    assert str(times) == (
        "step time p50 110.0 ms, p95 188.0 ms, p99 197.6 ms, max 200.0 ms; 2 of 4 steps late by "
        "more than a tenth, 2 without a working device"
    )


@pytest.mark.parametrize(("seconds", "missed"), [(0.0549, 0.0), (0.0551, 1.0), (0.01, 0.0)])
def test_a_deadline_is_missed_by_more_than_a_tenth(seconds, missed):
    times = StepTimes(pace=20.0)
    times.add(batch([seconds]))
    assert times.figures()["deadlines_missed"] == missed


def test_batches_of_any_shape():
    flat, square, single = (StepTimes(pace=10.0) for _ in range(3))
    seconds = [0.0, 0.1, 0.11, 0.12, 0.0, 0.3]
    flat.add(batch(seconds))
    square.add(batch(seconds, shape=[2, 3]))
    for second in seconds:
        single.add(batch(second, shape=[]))
    assert flat.figures() == square.figures() == single.figures()
    assert flat.figures()["steps_timed"] == 4.0


def test_nothing_where_nobody_held_a_pace():
    unpaced = StepTimes(None)
    unpaced.add(batch([0.1, 0.2]))
    assert unpaced.figures() == {} and str(unpaced) == ""
    untimed = StepTimes(10.0)
    untimed.add(TensorDict({"next": TensorDict({"reward": torch.zeros(3, 1)}, [3])}, [3]))
    assert untimed.figures() == {} and str(untimed) == ""
    # First steps only, and the empty batch of a pause.
    untimed.add(batch([0.0]))
    untimed.add(batch([], shape=[0]))
    assert untimed.figures() == {} and str(untimed) == ""


def test_what_was_added_is_kept_when_the_batch_is_used_again():
    times = StepTimes(pace=10.0)
    reused = batch([0.1, 0.1])
    times.add(reused)
    reused["next", "step_time"].fill_(9.0)
    assert times.figures()["step_ms_max"] == pytest.approx(100.0)
