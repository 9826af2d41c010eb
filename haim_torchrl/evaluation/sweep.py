"""Several runs as one command: what is left to do after an interruption, and all results."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hydra.conf import HydraConf
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from haim_torchrl.evaluation.command import ERROR_FILE, FAILED
from haim_torchrl.evaluation.comparison import (
    comparison_table,
    draw_comparison,
    read_runs,
    write_comparison,
)
from haim_torchrl.evaluation.resume import resumed_config
from haim_torchrl.evaluation.schema import ResumableConfig
from haim_torchrl.evaluation.tables import print_tables
from haim_torchrl.report.runs import RESULT_FILE

AUTO = "auto"
"""Value of ``resume`` for a run of a sweep: go on with whatever its folder holds."""


def remaining(
    config: DictConfig, hydra: HydraConf, schema: type[ResumableConfig]
) -> DictConfig | None:
    """What is left to do of a run of a sweep that may have been interrupted before.

    Args:
        config: Settings of the run; ``resume`` is ``auto``.
        hydra: Hydra's own settings of this job.
        schema: Types of the settings.

    Returns:
        Settings to train with: of a fresh run, or of the last checkpoint. None for a run that is
        finished. What a run left that had not come to its first checkpoint is moved aside.
    """
    folder = Path(hydra.runtime.output_dir)
    (folder / ERROR_FILE).unlink(missing_ok=True)
    if (folder / RESULT_FILE).exists():
        print(f"{folder} is finished and not run again", flush=True)
        return None
    if (folder / "checkpoints" / "last.pt").exists():
        config.resume = str(folder)
        config = resumed_config(config, hydra, schema)
        config.resume = str(folder)
        return config
    if folder.exists() and any(folder.iterdir()):
        number = 1
        while (aside := folder.with_name(f"{folder.name}.unsaved{number}")).exists():
            number += 1
        folder.rename(aside)
    config.resume = None
    return config


class Gather(Callback):
    """Puts the results of a sweep's runs into one table and one figure when all have ended.

    Hydra calls it (``hydra.callbacks``). ``comparison.md``, ``comparison.csv`` and
    ``comparison.png`` in the sweep's folder are written anew each time.

    Raises:
        SystemExit: if some runs have failed; the others are gathered first.
    """

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Gather what there is."""
        folder = Path(config.hydra.sweep.dir)
        methods = read_runs(folder)
        if methods:
            print_tables(comparison_table(methods))
            write_comparison(methods, folder)
            draw_comparison(methods, folder / "comparison.png")
            count = sum(method.seeds for method in methods.values())
            print(f"{count} runs are compared in {folder}/comparison.md")
        failed = sorted(folder.rglob(ERROR_FILE))
        for path in failed:
            name = path.parent.relative_to(folder)
            print(f"{name} failed: {path.read_text().strip()}", file=sys.stderr)
        if failed:
            sys.exit(FAILED)
