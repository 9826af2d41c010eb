"""The demonstrations that a method begins with: a dataset's, or driven fresh by the mentor."""

from __future__ import annotations

from functools import partial

from omegaconf import DictConfig
from tensordict import NestedKey, TensorDictBase

from haim_torchrl.data.demonstrations import record_demonstrations
from haim_torchrl.data.minari import MinariError, load_minari
from haim_torchrl.evaluation.assembly import World, build
from haim_torchrl.evaluation.command import job_label
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.progress import ProgressLine


def warm_up(config: DictConfig, steps: int, observation_keys: list[NestedKey]) -> TensorDictBase:
    """Steps that the mentor drives alone, in training scenarios.

    Args:
        config: Settings of the run; ``demonstrations`` names a Minari dataset, or is null.
        steps: How many.
        observation_keys: What of the state is kept.

    Returns:
        ``[steps]``: observations and ``action``, and what else is known of them.

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
                observation_keys=[str(key) for key in observation_keys],
                on_step=partial(ProgressLine.update, progress),
            )
    env = world()
    try:
        data = load_minari(config.demonstrations, env)
    except MinariError as error:
        raise ConfigError(f"demonstrations cannot be used: {error}") from error
    finally:
        env.close()
    # Of a session that was exported, what the mentor did is a demonstration; the rest is not.
    data = data[data["intervention"].squeeze(-1)]
    if len(data) < steps:
        raise ConfigError(
            f"dataset {config.demonstrations} holds {len(data)} demonstrated steps and "
            f"dagger.warm_up is {steps}; use dagger.warm_up={len(data)} or another dataset"
        )
    return data[:steps]
