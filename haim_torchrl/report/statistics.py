"""Figures of a method over its seeds and the held-out scenarios that all of them drive.

A method's results are a matrix: a row for each seed, a column for each scenario. Both are samples,
of the trainings and of the roads there could have been, and they are crossed: a bad training is bad
on many scenarios, a hard scenario is hard for many trainings. The bootstrap here draws whole rows
and whole columns (the pigeonhole bootstrap: Owen 2007, doi:10.1214/07-AOAS122).

rliable is not used for this. Its stratified bootstrap draws the runs anew for each task, as if a
training were independent from scenario to scenario, and its interquartile mean is over all cells of
the matrix: of outcomes that are 0 or 1 it leaves out the failures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haim_torchrl.evaluation.statistics import RESAMPLES, Estimate, check_level

Array = NDArray[np.float64]


def interquartile_mean(values: ArrayLike) -> Array:
    """Mean of the middle half along the last axis (Agarwal et al. 2021, arXiv:2108.13264).

    A value on the border of the middle half counts with the share of it that is inside, so that
    the mean of 1 or 2 values is the plain one, and of 3 the outer two weigh a quarter each.

    Args:
        values: ``[..., n]`` with n at least 1.

    Returns:
        ``[...]``.

    Example:
        >>> float(interquartile_mean([0.0, 2.0, 4.0, 100.0]))
        3.0
        >>> float(interquartile_mean([1.0, 4.0]))
        2.5
    """
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=-1)
    count = ordered.shape[-1]
    edges = np.clip(np.arange(count + 1) / count, 0.25, 0.75)
    return np.asarray(ordered @ (np.diff(edges) / 0.5))


@dataclass(frozen=True)
class Scores:
    """A measure of a method, as a ratio of sums over scenarios.

    Attributes:
        numerators: ``[seeds, scenarios]``.
        denominators: ``[seeds, scenarios]``: ones for a mean over scenarios, steps for a rate.
    """

    numerators: Array
    denominators: Array

    def __post_init__(self) -> None:
        """Check the shapes."""
        if self.numerators.shape != self.denominators.shape or self.numerators.ndim != 2:
            raise ValueError(
                "numerators and denominators must both be [seeds, scenarios]; got "
                f"{self.numerators.shape} and {self.denominators.shape}"
            )

    @classmethod
    def of(cls, numerators: ArrayLike, denominators: ArrayLike | None = None) -> Scores:
        """From nested sequences, ``[seeds][scenarios]``; the denominators are ones by default."""
        top = np.asarray(numerators, dtype=np.float64)
        bottom = np.ones_like(top) if denominators is None else denominators
        return cls(top, np.asarray(bottom, dtype=np.float64))

    @classmethod
    def of_runs(cls, values: ArrayLike) -> Scores:
        """One number a run that no scenario stands behind, such as a total of the training.

        Args:
            values: ``[seeds]``; runs whose number is NaN are left out.
        """
        column = np.asarray(values, dtype=np.float64).reshape(-1, 1)
        return cls.of(column[np.isfinite(column[:, 0])])

    def scaled(self, factor: float) -> Scores:
        """The measure times a number, such as -1 where less of it is better."""
        return Scores(factor * self.numerators, self.denominators)

    def figures(self, times: ArrayLike | None = None) -> Array:
        """The measure of each seed.

        Args:
            times: How often each scenario counts, ``[..., scenarios]``; once by default.

        Returns:
            ``[..., seeds]``.
        """
        often = np.ones(self.numerators.shape[1]) if times is None else np.asarray(times)
        bottom = often @ self.denominators.T
        top = often @ self.numerators.T
        return np.divide(top, bottom, out=np.full(np.shape(top), np.nan), where=bottom > 0.0)


def _scenario_draws(count: int, resamples: int, generator: np.random.Generator) -> Array:
    """How often each of ``count`` scenarios is in each resample, ``[resamples, count]``."""
    shares = np.full(count, 1.0 / count)
    return generator.multinomial(count, shares, size=resamples).astype(np.float64)


def _seed_draws(figures: Array, generator: np.random.Generator) -> Array:
    """Figures ``[resamples, seeds]`` with the seeds of each resample drawn with replacement."""
    chosen = generator.integers(0, figures.shape[1], size=figures.shape)
    return np.take_along_axis(figures, chosen, axis=1)


def _interval(draws: Array, level: float) -> tuple[float, float]:
    known = draws[np.isfinite(draws)]
    if not len(known):
        return math.nan, math.nan
    low, high = np.quantile(known, [0.5 - level / 2.0, 0.5 + level / 2.0])
    return float(low), float(high)


def crossed_interval(
    scores: Scores, level: float = 0.95, resamples: int = RESAMPLES, seed: int = 0
) -> Estimate:
    """Interquartile mean over seeds of their figures, with a bootstrap over seeds and scenarios.

    A seed's figure is over all of its scenarios, failures included: what the interquartile mean
    makes harmless is a training that went wrong. With one seed only scenarios are drawn, with
    totals of a training only seeds, and with neither there is no interval. With few seeds the
    interval is rather too narrow.

    Args:
        scores: The measure.
        level: Confidence level.
        resamples: Bootstrap resamples.
        seed: Seed of the resampling, so that the same runs always give the same interval.

    Returns:
        The estimate; ``count`` is the number of seeds. NaN without any.

    Raises:
        ValueError: If the level is impossible.
    """
    check_level(level)
    seeds, scenarios = scores.numerators.shape
    if seeds == 0 or scenarios == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    value = float(interquartile_mean(scores.figures()))
    if seeds == scenarios == 1:
        return Estimate(value, math.nan, math.nan, 1)
    generator = np.random.default_rng(seed)
    drawn = _seed_draws(scores.figures(_scenario_draws(scenarios, resamples, generator)), generator)
    return Estimate(value, *_interval(interquartile_mean(drawn), level), seeds)


def probability_of_improvement(
    first: Scores,
    second: Scores,
    level: float = 0.95,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Estimate:
    """Probability that a training of one method ends with a higher figure than one of another.

    Over all pairs of a seed of each, ties counting half; a figure is over the whole test. The
    bootstrap draws the seeds of each method apart and the scenarios together, since both drove
    the same.

    Args:
        first: The method that may be better, ``[seeds, scenarios]``.
        second: The other one, with the same scenarios in the same order.
        level: Confidence level.
        resamples: Bootstrap resamples.
        seed: Seed of the resampling.

    Returns:
        The estimate; ``count`` is the number of pairs.

    Raises:
        ValueError: If the scenarios differ in number, or the level is impossible.
    """
    check_level(level)
    scenarios = first.numerators.shape[1]
    if scenarios != second.numerators.shape[1]:
        raise ValueError(
            f"both methods must have driven the same scenarios; got {scenarios} and "
            f"{second.numerators.shape[1]}"
        )
    pairs = len(first.numerators) * len(second.numerators)
    if pairs == 0 or scenarios == 0:
        return Estimate(math.nan, math.nan, math.nan, 0)
    generator = np.random.default_rng(seed)
    often = _scenario_draws(scenarios, resamples, generator)
    drawn = _wins(
        _seed_draws(first.figures(often), generator), _seed_draws(second.figures(often), generator)
    )
    value = float(_wins(first.figures()[None], second.figures()[None])[0])
    return Estimate(value, *_interval(drawn, level), pairs)


def _wins(first: Array, second: Array) -> Array:
    """Share of pairs that the first wins, ``[b]`` from ``[b, n]`` and ``[b, m]``; a tie is half."""
    gap = first[:, :, None] - second[:, None, :]
    return np.asarray((0.5 + 0.5 * np.sign(gap)).mean((1, 2)))
