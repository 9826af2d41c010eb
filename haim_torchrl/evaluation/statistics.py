"""Intervals for what was measured over a limited number of episodes.

Episodes are the independent units, the steps within one are not: every interval here resamples or
counts whole episodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 2000


@dataclass(frozen=True)
class Estimate:
    """A measured value with its confidence interval.

    Attributes:
        value: The estimate; NaN when nothing was measured.
        low: Lower end of the interval.
        high: Upper end of the interval.
        count: Number of episodes (or runs) behind it.
    """

    value: float
    low: float
    high: float
    count: int

    def as_dict(self) -> dict[str, float | int | None]:
        """The fields with NaN as None, since JSON knows no NaN."""
        return {
            key: None if isinstance(number, float) and math.isnan(number) else number
            for key, number in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, fields: dict[str, float | int | None]) -> Estimate:
        """The inverse of :meth:`as_dict`."""
        value, low, high = (
            math.nan if fields[key] is None else float(fields[key] or 0.0)
            for key in ("value", "low", "high")
        )
        return cls(value, low, high, int(fields["count"] or 0))


def check_level(level: float) -> None:
    """Refuse a confidence level that is none, such as 95.

    Raises:
        ValueError: If it does not lie between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise ValueError(f"level must lie strictly between 0 and 1, such as 0.95; got {level}")


def wilson_interval(successes: int, trials: int, level: float = 0.95) -> Estimate:
    """Proportion with Wilson's score interval.

    Unlike the normal approximation it stays inside [0, 1] and does not shrink to a point when every
    episode succeeds (Wilson 1927, doi:10.1080/01621459.1927.10502953).

    Args:
        successes: Number of successes, 0 to ``trials``.
        trials: Number of episodes; with 0 the value is NaN and the interval [0, 1].
        level: Confidence level.

    Raises:
        ValueError: If the counts or the level are impossible.

    Example:
        >>> estimate = wilson_interval(8, 10)
        >>> round(estimate.low, 3), round(estimate.high, 3)
        (0.49, 0.943)
    """
    check_level(level)
    if not 0 <= successes <= trials:
        raise ValueError(f"successes must lie in 0..trials; got {successes} of {trials}")
    if trials == 0:
        return Estimate(math.nan, 0.0, 1.0, 0)
    z = NormalDist().inv_cdf(0.5 + level / 2.0)
    share = successes / trials
    scale = 1.0 + z * z / trials
    centre = (share + z * z / (2.0 * trials)) / scale
    half = z / scale * math.sqrt(share * (1.0 - share) / trials + z * z / (4.0 * trials**2))
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == trials else min(1.0, centre + half)
    return Estimate(share, low, high, trials)


def ratio_interval(
    numerators: ArrayLike,
    denominators: ArrayLike,
    level: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """Ratio of sums over episodes, with a percentile bootstrap over episodes.

    The share of steps with some flag is such a ratio: flagged steps over steps. Long episodes then
    weigh as much as they should, and the interval still resamples whole episodes.

    Args:
        numerators: One number an episode, ``[n]``.
        denominators: One number an episode, ``[n]``.
        level: Confidence level.
        resamples: Bootstrap resamples.
        seed: Seed of the resampling, so that the same episodes always give the same interval.

    Raises:
        ValueError: If the shapes differ or the level is impossible.
    """
    check_level(level)
    top = np.asarray(numerators, dtype=np.float64)
    bottom = np.asarray(denominators, dtype=np.float64)
    if top.shape != bottom.shape or top.ndim != 1:
        raise ValueError(
            "numerators and denominators must be one-dimensional and equally long; "
            f"got {top.shape} and {bottom.shape}"
        )
    count = len(top)
    if count == 0 or bottom.sum() == 0.0:
        return Estimate(math.nan, math.nan, math.nan, count)
    value = float(top.sum() / bottom.sum())
    if count == 1:
        return Estimate(value, math.nan, math.nan, 1)
    rows = np.random.default_rng(seed).integers(0, count, size=(resamples, count))
    tops, bottoms = top[rows].sum(1), bottom[rows].sum(1)
    ratios = tops[bottoms > 0.0] / bottoms[bottoms > 0.0]
    low, high = np.quantile(ratios, [0.5 - level / 2.0, 0.5 + level / 2.0])
    return Estimate(value, float(low), float(high), count)


def mean_interval(
    values: Sequence[float] | ArrayLike,
    level: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """Mean over episodes with a percentile bootstrap interval.

    Args:
        values: One number an episode, ``[n]``.
        level: Confidence level.
        resamples: Bootstrap resamples.
        seed: Seed of the resampling.
    """
    array = np.asarray(values, dtype=np.float64)
    return ratio_interval(array, np.ones_like(array), level, resamples, seed)


def range_interval(values: Iterable[float]) -> Estimate:
    """Mean over independent training runs, with the lowest and the highest of them.

    Args:
        values: One number a run; NaN is left out.
    """
    known = [float(value) for value in values if not math.isnan(value)]
    if not known:
        return Estimate(math.nan, math.nan, math.nan, 0)
    return Estimate(sum(known) / len(known), min(known), max(known), len(known))
