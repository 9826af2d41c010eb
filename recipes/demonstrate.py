"""Record demonstrations: the mentor, or a trained policy, drives alone into a Minari dataset.

python recipes/demonstrate.py                          # the expert, 49 000 steps
python recipes/demonstrate.py dataset=platoon/short-v0 steps=2000 seed=1
python recipes/demonstrate.py driver=policy checkpoint=runs/haim/<date> dataset=platoon/haim-v0
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from haim_torchrl.data.demonstrations import drive_demonstrations
from haim_torchrl.data.minari_format import Spaces, check_ranges
from haim_torchrl.data.minari_writer import DatasetEpisode, new_folder, write_dataset
from haim_torchrl.data.quality import Quality
from haim_torchrl.evaluation.assembly import Sizes, World, build_actor, build_driver, prepare
from haim_torchrl.evaluation.checkpoint import find_checkpoint
from haim_torchrl.evaluation.command import (
    INTERRUPTED,
    InterruptFlag,
    open_folder,
    register,
    reporting,
    run_command,
)
from haim_torchrl.evaluation.demonstrations import (
    check_demonstration,
    dataset_errors,
    demonstration_card,
    describe_driver,
    say_quality,
)
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.evaluation.resume import evaluated_config
from haim_torchrl.evaluation.run import load_policy


def demonstrate(config: DictConfig, checkpoint: Path | None) -> Path:
    """Drive, write the dataset, and say what it is worth."""
    device = prepare(config)
    check_demonstration(config)
    new_folder(config.dataset)  # tells now, not after the drive, that there is one
    world = World.of(config, "train", takeovers=False)
    actor = None
    if checkpoint is not None:
        actor = build_actor(config, Sizes.of_world(world), device)
        load_policy(checkpoint, actor)
    driver = build_driver(config.driver, actor, config)
    env = world()
    spaces = Spaces.of(env)
    open_folder(config)

    episodes: list[DatasetEpisode] = []
    with InterruptFlag() as interrupt, ProgressLine(config.steps) as progress:
        for scenario, steps in drive_demonstrations(
            lambda: env,
            driver,
            config.steps,
            world.seeds(),
            seed=config.seed,
            on_step=partial(ProgressLine.update, progress),
        ):
            check_ranges(steps, spaces.observation, spaces.action, f"scenario {scenario}")
            episodes.append(DatasetEpisode(steps, scenario))
            if interrupt:
                break

    quality = Quality.of([episode.steps for episode in episodes])
    who = describe_driver(config)
    folder = write_dataset(
        config.dataset,
        episodes,
        spaces,
        card=demonstration_card(config, quality),
        algorithm_name=f"haim_torchrl: {who}",
        description=f"Demonstrations by {who}, which drove each step alone. {quality}.",
        author=config.author,
    )
    say_quality(who, quality)
    print(f"dataset {config.dataset} is in {folder}")
    if interrupt:
        sys.exit(INTERRUPTED)
    return folder


register()


@hydra.main(version_base="1.3", config_path="../conf", config_name="demonstrate")
def main(config: DictConfig) -> None:
    """Hydra's entry point."""
    with reporting(), dataset_errors():
        checkpoint = None
        if config.checkpoint is not None:
            check_demonstration(config)
            checkpoint = find_checkpoint(config.checkpoint, ("best.pt", "last.pt"))
            config = evaluated_config(config, HydraConfig.get(), checkpoint)
        demonstrate(config, checkpoint)


if __name__ == "__main__":
    run_command(main)
