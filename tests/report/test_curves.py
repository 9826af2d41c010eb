"""Curves over seeds against values worked out by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from haim_torchrl.report.curves import band, draw_figures, series
from haim_torchrl.report.gathering import gather
from haim_torchrl.report.runs import FinishedRun

Writer = Callable[..., Path]


def test_a_takeover_rate_is_what_the_mentor_drove_of_each_stretch() -> None:
    course = {"frames": [100, 200, 400], "mentor_steps": [80, 120, 140], "violations": [0, 1, 1]}
    run = FinishedRun("haim", 0, course=course)
    steps, rates = series(run, "takeover_rate", "frames")
    assert steps.tolist() == [100.0, 200.0, 400.0]
    assert rates.tolist() == [0.8, 0.4, 0.1]
    steps, violations = series(run, "violations_total", "mentor_steps")
    assert (steps.tolist(), violations.tolist()) == ([80.0, 120.0, 140.0], [0.0, 1.0, 1.0])


def test_learning_from_a_data_set_is_a_point() -> None:
    course = {"frames": [900, 900], "mentor_steps": [900, 900], "violations": [0, 0]}
    run = FinishedRun("bc", 0, course=course)
    steps, rates = series(run, "takeover_rate", "frames")
    assert (steps.tolist(), rates.tolist()) == ([900.0], [1.0])


def test_unknown_values_are_left_out() -> None:
    validation = {"frames": [1, 2, 3], "success": [0.5, None, 1.0]}
    steps, values = series(FinishedRun("haim", 0, validation=validation), "success", "frames")
    assert (steps.tolist(), values.tolist()) == ([1.0, 3.0], [0.5, 1.0])
    assert not len(series(FinishedRun("haim", 0), "success", "frames")[0])


def test_a_band_is_mean_lowest_and_highest() -> None:
    steps = np.array([0.0, 10.0])
    found = band([(steps, np.array([0.0, 1.0])), (steps, np.array([1.0, 2.0]))])
    assert found is not None
    assert found.steps.tolist() == [0.0, 10.0] and found.mean.tolist() == [0.5, 1.5]
    assert found.low.tolist() == [0.0, 1.0] and found.high.tolist() == [1.0, 2.0]


def test_seeds_measured_at_different_steps_are_interpolated_where_all_are_known() -> None:
    first = (np.array([0.0, 10.0]), np.array([0.0, 1.0]))
    second = (np.array([5.0, 20.0]), np.array([1.0, 1.0]))
    found = band([first, second])
    assert found is not None
    assert (found.steps[0], found.steps[-1]) == (5.0, 10.0)
    assert (found.mean[0], found.mean[-1]) == (pytest.approx(0.75), pytest.approx(1.0))
    apart = (np.array([30.0, 40.0]), np.array([1.0, 1.0]))
    assert band([first, apart]) is None and band([]) is None


def test_a_figure_is_drawn_where_there_is_something_to_compare(
    write_run: Writer, tmp_path: Path
) -> None:
    write_run("haim", 0, [1])
    alone = draw_figures(gather([tmp_path]).methods, "haim", tmp_path)
    assert [path.name for _, path in alone] == ["others.png"]
    write_run("bc", 0, [1], mentor=0)
    write_run("mine", 0, [1])
    drawn = draw_figures(gather([tmp_path]).methods, "haim", tmp_path)
    assert [path.name for _, path in drawn] == ["fig7.png", "others.png"]
    assert all(path.stat().st_size > 10_000 for _, path in drawn)
