"""Interquartile means and crossed intervals against values worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.report.statistics import (
    Scores,
    crossed_interval,
    interquartile_mean,
    probability_of_improvement,
)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([7.0], 7.0),
        ([1.0, 4.0], 2.5),
        ([0.0, 1.0, 8.0], (0.25 * 0.0 + 1.0 + 0.25 * 8.0) / 1.5),
        ([9.0, 1.0, 2.0, -50.0], 1.5),
        # Of five, one and a quarter fall away at either end.
        ([0.0, 1.0, 2.0, 5.0, 90.0], (0.75 * 1.0 + 2.0 + 0.75 * 5.0) / 2.5),
    ],
)
def test_the_middle_half(values: list[float], expected: float) -> None:
    assert float(interquartile_mean(values)) == pytest.approx(expected)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20))
def test_the_middle_half_lies_within_and_shifts_along(values: list[float]) -> None:
    middle = float(interquartile_mean(values))
    assert min(values) - 1e-6 <= middle <= max(values) + 1e-6
    shifted = float(interquartile_mean([value + 1.0 for value in values]))
    assert shifted == pytest.approx(middle + 1.0, abs=1e-6)


def test_one_training_gone_wrong_hardly_counts() -> None:
    good, bad = [1.0, 1.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0]
    assert crossed_interval(Scores.of([good, good, good, bad])).value == 0.75


def test_failures_of_single_episodes_do_count() -> None:
    """Over all cells the interquartile mean of 80 % success would be 1."""
    runs = [[1.0, 1.0, 1.0, 1.0, 0.0]] * 4
    assert crossed_interval(Scores.of(runs)).value == pytest.approx(0.8)


def test_a_rate_is_a_ratio_of_sums() -> None:
    scores = Scores.of([[1.0, 0.0]], [[10.0, 90.0]])
    assert crossed_interval(scores).value == pytest.approx(0.01)


def test_where_nothing_differs_the_interval_is_a_point() -> None:
    estimate = crossed_interval(Scores.of([[0.5] * 6] * 3))
    assert (estimate.value, estimate.low, estimate.high, estimate.count) == (0.5, 0.5, 0.5, 3)


def test_one_seed_has_an_interval_over_scenarios() -> None:
    """50 scenarios, half of them 1: a binomial's standard deviation of 0.5 / sqrt(50)."""
    estimate = crossed_interval(Scores.of([[0.0, 1.0] * 25]))
    assert estimate.count == 1
    width = 2 * 1.96 * 0.5 / math.sqrt(50)
    assert estimate.high - estimate.low == pytest.approx(width, abs=0.05)


def test_totals_have_an_interval_over_seeds_and_one_of_them_none() -> None:
    several = crossed_interval(Scores.of_runs([1.0, 2.0, 3.0, math.nan]))
    assert (several.value, several.low, several.high, several.count) == (2.0, 1.0, 3.0, 3)
    one = crossed_interval(Scores.of_runs([4.0]))
    assert one.value == 4.0 and math.isnan(one.low) and math.isnan(one.high)
    assert math.isnan(crossed_interval(Scores.of_runs([])).value)


def test_scenarios_and_seeds_are_drawn_whole() -> None:
    """Half of either matrix is 1; where the variation lies makes the interval.

    If the seeds differ, two draws of two decide: everything from 0 to 1 is possible. If only the
    scenarios differ, two seeds are no better than one, since they fail on the same: as wide as a
    binomial of 100, and not of 200.
    """
    seeds_differ = crossed_interval(Scores.of([[0.0] * 100, [1.0] * 100]))
    assert (seeds_differ.low, seeds_differ.high) == (0.0, 1.0)
    scenarios_differ = crossed_interval(Scores.of([[0.0, 1.0] * 50] * 2))
    width = 2 * 1.96 * 0.5 / math.sqrt(100)
    assert scenarios_differ.high - scenarios_differ.low == pytest.approx(width, abs=0.03)


def test_probability_of_improvement_by_hand() -> None:
    first = Scores.of([[1.0, 1.0], [1.0, 0.0]])  # 1.0 and 0.5
    second = Scores.of([[1.0, 0.0], [0.0, 0.0]])  # 0.5 and 0.0
    # Of four pairs three are won and one is a tie.
    assert probability_of_improvement(first, second).value == 3.5 / 4
    assert probability_of_improvement(second, first).value == 0.5 / 4
    assert probability_of_improvement(first, second).count == 4
    assert probability_of_improvement(first.scaled(-1.0), second.scaled(-1.0)).value == 0.5 / 4


def test_shared_scenarios_are_drawn_for_both() -> None:
    """One method is a little better on each scenario: better whichever are drawn."""
    roads = np.arange(20.0)
    estimate = probability_of_improvement(Scores.of([roads + 0.1]), Scores.of([roads]))
    assert (estimate.value, estimate.low, estimate.high) == (1.0, 1.0, 1.0)
    equal = probability_of_improvement(Scores.of([roads]), Scores.of([roads]))
    assert (equal.value, equal.low, equal.high) == (0.5, 0.5, 0.5)


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(ValueError, match="the same scenarios; got 2 and 1"):
        probability_of_improvement(Scores.of([[1.0, 0.0]]), Scores.of([[1.0]]))
    with pytest.raises(ValueError, match=r"must both be \[seeds, scenarios\]"):
        Scores.of([1.0, 2.0])
    with pytest.raises(ValueError, match="level"):
        crossed_interval(Scores.of([[1.0]]), level=95)
