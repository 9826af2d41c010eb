"""Two trained policies on the same scenario, as in the paper's Fig. 10."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.evaluation.assembly import Sizes, World, build_actor
from haim_torchrl.evaluation.checkpoint import CheckpointError, find_checkpoint, load_checkpoint
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.drivers import PolicyDriver
from haim_torchrl.evaluation.pictures import platoon_figure, top_view
from haim_torchrl.evaluation.recording import Episode
from haim_torchrl.evaluation.report import drive_set
from haim_torchrl.evaluation.resume import saved_config
from haim_torchrl.evaluation.run import load_policy
from haim_torchrl.evaluation.schema import ScenarioSet
from haim_torchrl.report.methods import Method
from haim_torchrl.report.paper import known


def drive_again(folder: Path, scenario: int | None) -> tuple[Episode, DictConfig]:
    """Drive a scenario with a run's best policy, without mentor, in the world of the run.

    Args:
        folder: The run's folder, with its checkpoints.
        scenario: Its number; None for the first one of the run's test.

    Returns:
        The recording and the settings of the run.

    Raises:
        CheckpointError: If the run has kept no policy that fits its settings.
        ConfigError: If its world cannot be built here.
    """
    path = find_checkpoint(folder, ("best.pt", "last.pt"))
    config = saved_config(load_checkpoint(path), path)
    world = World.of(config, "test", takeovers=False)
    first = world.scenarios.start if scenario is None else scenario
    world = replace(world, scenarios=ScenarioSet(start=first, count=1))
    actor = build_actor(config, Sizes.of_world(world), torch.device("cpu"))
    load_policy(path, actor)
    result = drive_set(PolicyDriver(actor), world, record=[first], label=str(config.name))
    return result.episodes[0], config


def draw_side_by_side(
    methods: dict[str, Method], names: list[str], scenario: int | None, folder: Path
) -> tuple[list[tuple[str, Path]], list[str]]:
    """Drive one scenario with the first seed of each method and draw it.

    Args:
        methods: Methods by name.
        names: Those to drive.
        scenario: Number of the scenario; None for the first one of the test.
        folder: Where the images go.

    Returns:
        Titles and images, and a sentence for each method that could not drive.
    """
    driven: list[tuple[str, Episode]] = []
    pictures, problems, brake_limit = [], [], -5.0
    for name in names:
        run = methods[name].runs[0] if name in methods else None
        if run is None or run.folder is None:
            problems.append(f"side_by_side: no run folder of {name} was given, so it cannot drive")
            continue
        try:
            episode, config = drive_again(run.folder, scenario)
        except (CheckpointError, ConfigError) as error:
            problems.append(f"side_by_side: {name} cannot drive: {error}")
            continue
        brake_limit = float(OmegaConf.select(config, "loss.implicit.cost.threshold"))
        scenario = episode.labels.index if scenario is None else scenario
        title = f"{known(name).title}, seed {run.seed}"
        driven.append((title, episode))
        pictures.append((f"Fig. 10: {title}", top_view(episode, folder / f"top_view_{name}.png")))
    if driven:
        title = f"Fig. 10: the platoon on scenario {scenario}"
        path = platoon_figure(driven, folder / "fig10.png", brake_limit)
        pictures.append((title, path))
    return pictures, problems
