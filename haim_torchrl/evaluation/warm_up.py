"""The demonstrations that dataset aggregation begins with: a dataset's, or the mentor's now."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from omegaconf import DictConfig
from tensordict import TensorDict

from haim_torchrl.data.demonstrations import record_demonstrations
from haim_torchrl.evaluation.assembly import World, build
from haim_torchrl.evaluation.command import job_label
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.demonstrations import load_mentor_steps
from haim_torchrl.evaluation.progress import ProgressLine


def warm_up(config: DictConfig, steps: int, observation_keys: Sequence[str]) -> TensorDict:
    """Steps that the mentor drives alone, in training scenarios.

    Args:
        config: Settings of the run; ``demonstrations`` names a Minari dataset, or is null.
        steps: How many.
        observation_keys: What of the state is kept of steps that are driven now.

    Returns:
        Transitions ``[steps]``.

    Raises:
        ConfigError: If the dataset cannot be used, or is too small.
    """
    world = World.of(config, "train", takeovers=False)
    if config.demonstrations is None:
        with ProgressLine(steps, unit="demonstrated steps", label=job_label()) as progress:
            return record_demonstrations(
                world,
                build(config.mentor),
                steps,
                world.seeds(),
                seed=config.seed,
                observation_keys=observation_keys,
                on_step=partial(ProgressLine.update, progress),
            )
    data = load_mentor_steps(config.demonstrations, world, config)
    if len(data) < steps:
        raise ConfigError(
            f"dataset {config.demonstrations} holds {len(data)} demonstrated steps and "
            f"dagger.warm_up is {steps}; set dagger.warm_up and total_frames lower, or choose "
            "another dataset"
        )
    return data[:steps]
