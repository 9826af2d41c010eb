"""How a training recipe begins and ends, the same for every method."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from haim_torchrl.evaluation.command import INTERRUPTED, job_label, reporting
from haim_torchrl.evaluation.drivers import PolicyDriver
from haim_torchrl.evaluation.report import final_report
from haim_torchrl.evaluation.resume import resumed_config
from haim_torchrl.evaluation.run import Run, load_policy, peak_memory
from haim_torchrl.evaluation.schema import ResumableConfig
from haim_torchrl.evaluation.sweep import AUTO, remaining


def run_recipe(
    config: DictConfig, train: Callable[[DictConfig], Any], schema: type[ResumableConfig]
) -> None:
    """Train as the settings say: a new run, a resumed one, or what is left to do of a sweep.

    Args:
        config: Settings from the files and the command line.
        train: The recipe.
        schema: Types of its settings.
    """
    hydra_config = HydraConfig.get()
    todo: DictConfig | None = config
    with reporting(go_on=bool(job_label())):
        if config.resume == AUTO:
            todo = remaining(config, hydra_config, schema)
        elif config.resume:
            todo = resumed_config(config, hydra_config, schema)
        if todo is not None:
            train(todo)


def leave(run: Run, recipe: str) -> NoReturn:
    """Save an interrupted run and say how to go on.

    Args:
        run: The run, between two batches.
        recipe: Path of its recipe, such as ``recipes/haim.py``.
    """
    run.save()
    print(f"saved; go on with: python {recipe} resume={run.folder}")
    sys.exit(INTERRUPTED)


def conclude(run: Run, extra: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Drive the held-out scenarios with the policy that ``eval.checkpoint`` names.

    The run's actor holds that policy afterwards.

    Args:
        run: A run that has done all its steps.
        extra: Further totals of the training for ``metrics.json``.

    Returns:
        What went into ``metrics.json``.
    """
    first, last = run.log.takeover_rates()
    totals = {
        **run.log.totals,
        "takeover_rate_first_fifth": first,
        "takeover_rate_last_fifth": last,
        "peak_memory_mib": peak_memory(),
        **run.log.step_times.figures(),
        **(extra or {}),
    }
    chosen = load_policy(run.checkpoints / f"{run.config.eval.checkpoint}.pt", run.actor)
    about: dict[str, Any] = {key: chosen[key] for key in ("frames", "validation") if key in chosen}
    contents = final_report(run.folder, run.config, PolicyDriver(run.actor), totals, about)
    if run.log.step_times.figures():
        print(run.log.step_times)
    print(f"everything is in {Path(run.folder)}", flush=True)
    return contents
