"""What learning from data alone needs before its loop: the data and the loss."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from functools import partial

from omegaconf import DictConfig
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import LossModule

from haim_torchrl.data.demonstrations import record_demonstrations
from haim_torchrl.evaluation.assembly import World, build
from haim_torchrl.evaluation.checkpoint import CheckpointError, find_checkpoint, load_checkpoint
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.demonstrations import load_demonstrations, load_mentor_steps
from haim_torchrl.evaluation.progress import ProgressLine
from haim_torchrl.objectives import TargetUpdater
from haim_torchrl.objectives.functional import shaped_reward

EDGE = 0.99
"""Actions are cut off here: a squashed policy has no density at 1, which it reaches at infinity."""

DISTANCES = ("l1", "l2", "smooth_l1")
"""What TorchRL's losses call them."""


def check_offline(config: DictConfig) -> None:
    """Refuse settings of ``recipes/offline.py`` that cannot work.

    Raises:
        ConfigError: With one sentence that names the key.
    """
    settings = config.offline
    for key in ("updates", "batch_size", "log_every", "checkpoint_every", "validate_every"):
        if settings[key] < 1:
            raise ConfigError(f"offline.{key} must be at least 1; got {settings[key]}")
    if settings.bc_updates < 0:
        raise ConfigError(f"offline.bc_updates must be at least 0; got {settings.bc_updates}")
    if settings.lr <= 0.0:
        raise ConfigError(f"offline.lr must be positive; got {settings.lr}")
    if not 0.0 <= settings.policy_average < 1.0:
        raise ConfigError(
            f"offline.policy_average must lie in [0, 1); got {settings.policy_average}"
        )
    if config.steps < 1:
        raise ConfigError(f"steps must be at least 1; got {config.steps}")
    if config.cost_weight < 0.0:
        raise ConfigError(f"cost_weight must be at least 0; got {config.cost_weight}")
    distance = config.objective.get("loss_function")
    if distance not in (None, *DISTANCES):
        raise ConfigError(
            f"objective.loss_function must be one of {', '.join(DISTANCES)}, or null for the "
            f"objective's own; got {distance}"
        )
    if config.demonstrations is not None and config.like is not None:
        raise ConfigError(
            "demonstrations and like are both given, and only one can say what is learned from; "
            "leave one out"
        )


def offline_data(
    config: DictConfig, world: World, actor: ProbabilisticActor, *, imitates: bool
) -> TensorDict:
    """What is learned from: a dataset, or what the mentor drives now.

    Args:
        config: Settings of the run.
        world: Training scenarios without takeovers.
        actor: The policy; what it reads is recorded.
        imitates: Whether what is learned is to do the same, rather than what comes of it. Steps
            that an agent drove, in a session that was exported, are left out then.

    Returns:
        Transitions ``[N]``. Their reward is the environment's less ``cost_weight`` times its cost.

    Raises:
        ConfigError: If the dataset cannot be learned from.
        CheckpointError: If there is no run to be like.
    """
    if config.demonstrations is not None:
        load = load_mentor_steps if imitates else load_demonstrations
        data = load(config.demonstrations, world, config)
    else:
        steps = config.steps if config.like is None else _mentor_steps(config.like)
        with ProgressLine(steps, unit="mentor steps") as progress:
            data = record_demonstrations(
                world,
                build(config.mentor),
                steps,
                world.seeds(),
                seed=config.seed,
                observation_keys=actor.in_keys,
                on_step=partial(ProgressLine.update, progress),
            )
    data["action"] = data["action"].clamp(-EDGE, EDGE)
    after = data["next"]
    if "cost" in after:
        after["reward"] = shaped_reward(after["reward"], after["cost"], config.cost_weight)
    return data


def _mentor_steps(run: str) -> int:
    path = find_checkpoint(run, ("last.pt",))
    try:
        steps = int(load_checkpoint(path)["parts"]["log"]["totals"]["mentor_steps"])
    except KeyError:
        raise CheckpointError(
            f"checkpoint {path} does not say how often a mentor drove; give like= the folder of "
            "a run of recipes/haim.py"
        ) from None
    if steps < 1:
        raise ConfigError(f"like={run} names a run in which the mentor never drove; use steps=")
    return steps


def build_objective(
    config: DictConfig,
    actor: ProbabilisticActor,
    make_critic: Callable[[], TensorDictModule] | None = None,
) -> tuple[LossModule, TargetUpdater | None]:
    """The loss of the group ``objective``, and what moves its targets if it has any.

    Args:
        config: Settings of the run.
        actor: The policy that it trains.
        make_critic: Builds a critic with one member, for a loss that has critics; None where such
            a loss has no place.

    Raises:
        ConfigError: If it refuses its settings.
    """
    with warnings.catch_warnings():  # about targets, which cloning has none of
        warnings.simplefilter("ignore", UserWarning)
        takes = inspect.signature(build(config.objective)).parameters
        if "qvalue_network" not in takes:
            return build(config.objective, actor_network=actor), None
        if make_critic is None:
            raise ConfigError("objective needs a critic; this recipe has losses that clone alone")
        critic = make_critic()
        loss = build(config.objective, actor_network=actor, qvalue_network=critic)
        loss.make_value_estimator(gamma=config.loss.gamma)
        return loss, TargetUpdater(loss, config.loss.tau)
