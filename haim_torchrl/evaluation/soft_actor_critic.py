"""From the group ``loss`` of the settings to soft actor-critic's loss around one actor."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

from omegaconf import DictConfig
from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import SACLoss

from haim_torchrl.evaluation.assembly import build
from haim_torchrl.evaluation.config import ConfigError, drives_live
from haim_torchrl.modules import encoder_of

SHAPED = "shaped_reward"
"""The entry that the critics of the reward learn from."""


def check_off_policy(config: DictConfig) -> None:
    """Refuse settings that soft actor-critic cannot learn with, or that need a mentor.

    Args:
        config: Settings of ``recipes/off_policy.py``.

    Raises:
        ConfigError: With one sentence that names the key.
    """
    if "objective" not in config.loss:
        raise ConfigError(
            "loss has no objective of soft actor-critic; choose algorithm=sac_rs or "
            "algorithm=sac_lag, or use recipes/haim.py for what learns from takeovers"
        )
    if not 0.0 <= config.loss.cost_weight < math.inf:
        raise ConfigError(
            f"loss.cost_weight must be a number of at least 0; got {config.loss.cost_weight}"
        )
    if not 0.0 <= config.loss.gamma <= 1.0:
        raise ConfigError(f"loss.gamma must lie in [0, 1]; got {config.loss.gamma}")
    if not 0.0 < config.loss.tau <= 1.0:
        raise ConfigError(f"loss.tau must lie in (0, 1]; got {config.loss.tau}")
    if drives_live(config):
        raise ConfigError(
            "collector=live drives in real time for a person, and here nobody takes over; use "
            "collector=sync or collector=parallel"
        )
    if config.record:
        raise ConfigError("record=true writes down who drove, and here nobody takes over; leave it")


def build_sac(
    settings: DictConfig,
    actor: ProbabilisticActor,
    make_critic: Callable[..., TensorDictModule],
) -> SACLoss:
    """The loss of soft actor-critic, with or without a limit on the cost.

    TorchRL makes the twins of the reward's critic itself, of one that is no ensemble; the cost's
    critic, where the objective has one, is an ensemble as everywhere here.

    Args:
        settings: The group ``loss``.
        actor: The actor.
        make_critic: Builds a fresh critic; takes ``ensemble_size``.

    Returns:
        The loss, which reads the reward from ``shaped_reward``.

    Raises:
        ConfigError: If it cannot be built, or the actor reads images.
    """
    if encoder_of(actor) is not None:
        raise ConfigError(
            "actor=cnn sees with the encoder of a critic of recipes/haim.py, which this one has "
            "not; use actor=tanh_normal critic=twin env/observation=numeric"
        )
    make_loss = build(settings.objective)
    networks: dict[str, Any] = {"qvalue_network": make_critic(ensemble_size=1)}
    if "cost_network" in inspect.signature(make_loss).parameters:
        networks["cost_network"] = make_critic()
    try:
        loss: SACLoss = make_loss(actor_network=actor, **networks)
        loss.set_keys(reward=SHAPED)
        loss.make_value_estimator(gamma=settings.gamma)
    except (TypeError, ValueError, RuntimeError, NotImplementedError) as error:
        raise ConfigError(f"loss.objective cannot be built: {error}") from error
    return loss.to(next(actor.parameters()).device)
