"""A trained policy as somebody else's mentor."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import torch
from torchrl.modules import ProbabilisticActor

from haim_torchrl.evaluation.assembly import Sizes, World, build_actor
from haim_torchrl.evaluation.checkpoint import find_checkpoint, load_checkpoint
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.resume import saved_config
from haim_torchrl.evaluation.run import load_policy
from haim_torchrl.mentors.policy import PolicyMentor


def policy_mentor(checkpoint: str | os.PathLike[str] | None) -> PolicyMentor:
    """The policy of a run as a mentor; loaded at first use, in the process that needs it.

    Args:
        checkpoint: A run's folder (its best policy) or a checkpoint.

    Raises:
        CheckpointError: If there is none.
        ConfigError: If none is named.
    """
    if checkpoint is None:
        raise ConfigError(
            "mentor.checkpoint has no value; give a run's folder, or a checkpoint of a policy"
        )
    return PolicyMentor(partial(_load, find_checkpoint(str(checkpoint), ("best.pt", "last.pt"))))


def _load(path: Path) -> ProbabilisticActor:
    config = saved_config(load_checkpoint(path), path)
    sizes = Sizes.of_world(World.of(config, "train", takeovers=False))
    actor = build_actor(config, sizes, torch.device("cpu"))
    load_policy(path, actor)
    return actor
