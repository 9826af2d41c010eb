"""Drive a scenario set and print the paper's Table 1 columns with confidence intervals.

python recipes/evaluate.py checkpoint=runs/haim/<date>
python recipes/evaluate.py checkpoint=runs/haim/<date> eval.set=validation driver=policy+mentor
python recipes/evaluate.py driver=[mentor,random,straight]
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.evaluation.assembly import Sizes, World, build_actor, build_driver, prepare
from haim_torchrl.evaluation.checkpoint import find_checkpoint
from haim_torchrl.evaluation.command import open_folder, register, reporting, run_command
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.report import draw_episode, drive_set, training_headings
from haim_torchrl.evaluation.resume import evaluated_config
from haim_torchrl.evaluation.run import load_policy
from haim_torchrl.evaluation.tables import main_table, print_tables, split_table, write_metrics


def evaluate(config: DictConfig, checkpoint: Path | None) -> Path:
    """Drive the set with each driver; write ``metrics.json``, and pictures of one scenario each."""
    device = prepare(config)
    drivers = [config.driver] if isinstance(config.driver, str) else list(config.driver)
    if not drivers:
        raise ConfigError("driver names nobody; choose policy, policy+mentor, mentor, random, ...")
    actor, trained = None, {}
    if checkpoint is not None:
        sizes = Sizes.of_world(World.of(config, config.eval.set, takeovers=False))
        actor = build_actor(config, sizes, device)
        trained = load_policy(checkpoint, actor)
    chosen = {name: build_driver(name, actor, config) for name in drivers}
    folder = open_folder(config)

    summaries, headings, results = {}, {}, {}
    for name, driver in chosen.items():
        world = World.of(config, config.eval.set, takeovers=name == "policy+mentor")
        recorded = [world.seeds()[0]] if config.eval.pictures else []
        result = drive_set(driver, world, workers=config.eval.workers, record=recorded, label=name)
        summaries[name] = result.summary(config.eval.level)
        headings[name] = training_headings(trained.get("totals")) if "policy" in name else {}
        results[name] = {
            **summaries[name].as_dict(),
            "episodes": [record.as_dict() for record in result.records],
        }
        for episode in result.episodes:
            (folder / name).mkdir()
            draw_episode(episode, folder / name, config.loss.implicit.cost.threshold)

    count = config.eval[config.eval.set].count
    print_tables(
        main_table(summaries, f"{count} {config.eval.set} scenarios", headings),
        split_table(summaries),
    )
    contents: dict[str, Any] = {
        "checkpoint": None if checkpoint is None else str(checkpoint),
        "scenarios": OmegaConf.to_container(config.eval[config.eval.set]),
        "drivers": results,
    }
    write_metrics(folder / "metrics.json", contents)
    print(f"everything is in {folder}")
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="evaluate")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    with reporting():
        checkpoint = None
        if config.checkpoint is not None:
            checkpoint = find_checkpoint(config.checkpoint, ("best.pt", "last.pt"))
            config = evaluated_config(config, HydraConfig.get(), checkpoint)
        evaluate(config, checkpoint)


if __name__ == "__main__":
    run_command(main)
