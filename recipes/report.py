"""The paper's Tables 1 and 2 and its figures from finished runs, as one HTML page.

python recipes/report.py 'runs=[runs]'                              # all runs below a folder
python recipes/report.py 'runs=[runs/haim,published/runs.json]' output=report
python recipes/report.py 'runs=[runs]' 'side_by_side=[haim,haco]'   # drive one scenario, Fig. 10
"""

from __future__ import annotations

from pathlib import Path

import hydra
from omegaconf import DictConfig

from haim_torchrl.evaluation.command import register, reporting, run_command
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.report.curves import draw_figures
from haim_torchrl.report.effort import effort_table
from haim_torchrl.report.gathering import gather
from haim_torchrl.report.improvement import improvement_table
from haim_torchrl.report.page import Report
from haim_torchrl.report.runs import publish
from haim_torchrl.report.side_by_side import draw_side_by_side
from haim_torchrl.report.tables import table1, table2


def report(config: DictConfig) -> Path:
    """Read the runs, write the report, and return its page."""
    sources = [config.runs] if isinstance(config.runs, str) else list(config.runs)
    if not sources:
        raise ConfigError("runs names nothing; give folders of runs, such as runs=[runs/haim]")
    if not 0.0 < config.level < 1.0:
        raise ConfigError(f"level must lie between 0 and 1, such as 0.95; got {config.level}")
    if config.resamples < 1:
        raise ConfigError(f"resamples must be at least 1; got {config.resamples}")
    found = gather(sources)
    for problem in found.problems:
        print(problem)
    if not found.methods:
        raise ConfigError(f"runs={sources} hold no finished run; a run ends with metrics.json")

    folder, methods = Path(config.output), found.methods
    folder.mkdir(parents=True, exist_ok=True)
    draws = {"level": config.level, "resamples": config.resamples}
    tables = [
        table1(methods, **draws),
        table2(methods, **draws),
        improvement_table(methods, config.reference, **draws),
        effort_table(methods, **draws),
    ]
    pictures = draw_figures(methods, config.reference, folder)
    driven, failures = draw_side_by_side(
        methods, list(config.side_by_side), config.scenario, folder
    )
    for problem in failures:
        print(problem)

    title = "HAIM-DRL beside other methods"
    contents = Report(title, [*found.problems, *failures], tables, [*pictures, *driven])
    page = contents.write(folder)
    runs = found.runs()
    publish(runs, folder / "runs.json")
    print(f"runs: {len(runs)}, methods: {len(methods)}; the page is {page}")
    return page


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="report")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    with reporting():
        report(config)


if __name__ == "__main__":
    run_command(main)
