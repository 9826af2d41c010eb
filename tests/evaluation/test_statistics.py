"""Intervals against published or hand-computed values."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.evaluation.statistics import (
    Estimate,
    mean_interval,
    range_interval,
    ratio_interval,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Newcombe 1998 (Statistics in Medicine 17:857), Table I, Wilson without continuity.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_matches_newcombe(successes: int, trials: int, low: float, high: float) -> None:
    estimate = wilson_interval(successes, trials)
    assert estimate.low == pytest.approx(low, abs=5e-5)
    assert estimate.high == pytest.approx(high, abs=5e-5)
    assert estimate.value == successes / trials


@given(st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_contains_the_share_and_stays_in_the_unit_interval(counts: tuple[int, int]) -> None:
    estimate = wilson_interval(*counts)
    assert 0.0 <= estimate.low <= estimate.value <= estimate.high <= 1.0
    assert estimate.low < estimate.high


def test_wilson_of_nothing_is_unknown() -> None:
    estimate = wilson_interval(0, 0)
    assert math.isnan(estimate.value)
    assert (estimate.low, estimate.high) == (0.0, 1.0)


@pytest.mark.parametrize(("successes", "trials"), [(-1, 5), (6, 5)])
def test_wilson_rejects_impossible_counts(successes: int, trials: int) -> None:
    with pytest.raises(ValueError, match="successes must lie in"):
        wilson_interval(successes, trials)


def test_level_must_be_a_probability() -> None:
    with pytest.raises(ValueError, match="level"):
        wilson_interval(1, 2, level=95)


def test_ratio_weighs_long_episodes() -> None:
    # 1 of 10 and 0 of 90 steps: 1 %, not the 5 % that the mean of the two rates would be.
    assert ratio_interval([1, 0], [10, 90]).value == pytest.approx(0.01)


def test_ratio_with_empty_denominator_is_unknown() -> None:
    assert math.isnan(ratio_interval([0.0], [0.0]).value)


def test_mean_interval_of_a_normal_sample_is_near_the_textbook_one() -> None:
    import numpy as np

    values = np.random.default_rng(1).normal(3.0, 2.0, size=400)
    estimate = mean_interval(values)
    half = 1.96 * values.std(ddof=1) / 20.0
    assert estimate.value == pytest.approx(values.mean())
    assert estimate.low == pytest.approx(values.mean() - half, abs=0.03)
    assert estimate.high == pytest.approx(values.mean() + half, abs=0.03)


def test_bootstrap_repeats_itself() -> None:
    assert mean_interval([1.0, 2.0, 5.0]) == mean_interval([1.0, 2.0, 5.0])


def test_constant_values_have_an_interval_of_no_width() -> None:
    estimate = mean_interval([2.0, 2.0, 2.0])
    assert (estimate.low, estimate.high) == (2.0, 2.0)


def test_runs_report_the_lowest_and_the_highest() -> None:
    estimate = range_interval([1.0, 2.0, float("nan"), 6.0])
    assert (estimate.value, estimate.low, estimate.high, estimate.count) == (3.0, 1.0, 6.0, 3)
    assert math.isnan(range_interval([]).value)


def test_estimate_survives_json() -> None:
    original = Estimate(0.5, math.nan, 1.0, 4)
    copy = Estimate.from_dict(original.as_dict())
    assert copy.value == 0.5 and math.isnan(copy.low) and copy.count == 4
    assert original.as_dict()["low"] is None
