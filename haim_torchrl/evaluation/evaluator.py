"""Drives a set of scenarios and records how each one ended."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field

import torch
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from haim_torchrl.evaluation.drivers import Driver, simulator_of
from haim_torchrl.evaluation.metrics import (
    EpisodeMeter,
    EpisodeRecord,
    Summary,
    steps_of,
    summarise,
)
from haim_torchrl.evaluation.recording import Episode, Recordable, record_start

EnvFactory = Callable[[], EnvBase]


@dataclass
class Evaluation:
    """Result of :func:`evaluate`.

    Attributes:
        records: One record per scenario, in the order asked for.
        episodes: Recordings of the scenarios that were to be recorded.
    """

    records: list[EpisodeRecord] = field(default_factory=list)
    episodes: list[Episode] = field(default_factory=list)

    def summary(self, level: float = 0.95) -> Summary:
        """Figures with confidence intervals; see :func:`~.metrics.summarise`."""
        return summarise(self.records, level)


def drive_episode(
    env: EnvBase,
    driver: Driver,
    scenario: int,
    *,
    record: bool = False,
    max_steps: int = 100_000,
) -> tuple[EpisodeRecord, Episode | None]:
    """Drive one scenario from its reset to its end.

    Args:
        env: Environment around one simulator in this process, without batch dimension.
        driver: Chooses the actions. An intervention transform in ``env`` may still override them.
        scenario: Seed that generates the scenario.
        record: Whether to keep the scenes.
        max_steps: Guard against an environment that never ends.

    Returns:
        The record, and the recording or None.

    Raises:
        RuntimeError: If the episode does not end.
    """
    simulator = simulator_of(env)
    state = env.reset(seed=int(scenario))
    labels = simulator.scenario_labels() if isinstance(simulator, Recordable) else None
    episode = record_start(simulator) if record else None
    meter = EpisodeMeter()
    meter.start(labels)
    driver.reset(simulator)
    for _ in range(max_steps):
        state.set("action", driver.act(simulator, state))
        state = env.step(state)
        step = steps_of(state.unsqueeze(-1))[0][0]
        if episode is not None:
            episode.snapshots.append(simulator.snapshot())
            episode.interventions.append(bool(step.get("intervention", 0.0)))
        result = meter.add(step)
        if result is not None:
            if episode is not None:
                episode.outcome = result.outcome
            return result, episode
        state = step_mdp(state)
    raise RuntimeError(f"scenario {scenario} did not end within {max_steps} steps")


def _drive_share(
    driver: Driver, make_env: EnvFactory, scenarios: Sequence[int], record: Collection[int]
) -> list[tuple[EpisodeRecord, Episode | None]]:
    torch.set_num_threads(1)
    env = make_env()
    try:
        return [drive_episode(env, driver, s, record=s in record) for s in scenarios]
    finally:
        env.close()


def evaluate(
    driver: Driver,
    make_env: EnvFactory,
    scenarios: Sequence[int],
    *,
    workers: int = 1,
    record: Collection[int] = (),
    on_episode: Callable[[EpisodeRecord], None] | None = None,
) -> Evaluation:
    """Drive each scenario once.

    Args:
        driver: A policy, mentor, or baseline driver; see :mod:`haim_torchrl.evaluation.drivers`.
        make_env: Builds the environment. With an intervention transform the mentor may take over;
            without, the driver is alone.
        scenarios: Seeds of the scenarios.
        workers: Processes; with more than 1, or with an environment that is the only one in its
            process (``make_env.one_per_process``, MetaDrive), the driver and ``make_env`` must be
            picklable.
        record: Scenarios whose scenes are kept for pictures.
        on_episode: Called after each episode, for a progress line.

    Raises:
        ValueError: If there is no scenario, or ``workers`` is not positive.
    """
    if not scenarios:
        raise ValueError("evaluate needs at least one scenario; give a set that is not empty")
    if workers < 1:
        raise ValueError(f"workers must be at least 1; got {workers}")
    results: dict[int, tuple[EpisodeRecord, Episode | None]] = {}

    def take(index: int, result: tuple[EpisodeRecord, Episode | None]) -> None:
        results[index] = result
        if on_episode is not None:
            on_episode(result[0])

    if workers == 1 and not getattr(make_env, "one_per_process", False):
        env = make_env()
        try:
            for index, scenario in enumerate(scenarios):
                take(index, drive_episode(env, driver, scenario, record=scenario in record))
        finally:
            env.close()
    else:
        # Interleaved shares, because neighbouring seeds are no harder than others but the last
        # worker to finish sets the time.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(workers, len(scenarios)), mp_context=context) as pool:
            shares = {
                pool.submit(_drive_share, driver, make_env, scenarios[k::workers], record): k
                for k in range(min(workers, len(scenarios)))
            }
            for done in as_completed(shares):
                for position, result in enumerate(done.result()):
                    take(shares[done] + position * workers, result)
    ordered = [results[index] for index in range(len(scenarios))]
    return Evaluation(
        records=[record_ for record_, _ in ordered],
        episodes=[episode for _, episode in ordered if episode is not None],
    )
