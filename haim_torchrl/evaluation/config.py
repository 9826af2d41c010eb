"""The checks of a run's settings that no type can make; :mod:`.schema` has the types."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.evaluation.schema import ScenarioSet


class ConfigError(ValueError):
    """Settings that cannot work; the message names the key and what to change."""


def scenario_set(node: Any) -> ScenarioSet:
    """A scenario set from its settings."""
    return ScenarioSet(start=int(node.start), count=int(node.count))


def check_scenarios(eval_config: Any) -> None:
    """Refuse scenario sets that are empty or share a scenario.

    A scenario that training or the choice of a checkpoint has seen is no test.

    Raises:
        ConfigError: With the names of the two sets.
    """
    sets = {name: scenario_set(eval_config[name]) for name in ("train", "validation", "test")}
    for name, chosen in sets.items():
        if chosen.count < 1 or chosen.start < 0:
            raise ConfigError(
                f"eval.{name} must have a start of at least 0 and a count of at least 1; got "
                f"start {chosen.start} and count {chosen.count}"
            )
    for first, second in (("train", "test"), ("validation", "test"), ("train", "validation")):
        a, b = sets[first], sets[second]
        low, high = max(a.start, b.start), min(a.start + a.count, b.start + b.count)
        if low < high:
            raise ConfigError(
                f"eval.{first} and eval.{second} share the scenarios {low} to {high - 1}; "
                f"change eval.{first}.start or eval.{first}.count"
            )


def check_config(config: DictConfig) -> None:
    """Refuse settings that contradict each other, before anything is built or written.

    Raises:
        ConfigError: With one sentence that names the key.
    """
    # The logger's folder is known to Hydra alone, so that its settings resolve in a job only.
    rest = [key for key in config if key != "logger"]
    missing = OmegaConf.missing_keys(OmegaConf.masked_copy(config, rest))  # type: ignore[arg-type]
    if missing:
        raise ConfigError(f"{sorted(missing)[0]} has no value; set it on the command line")
    if config.threads < 1:
        raise ConfigError(f"threads must be at least 1; got {config.threads}")
    for key, allowed in (
        ("checkpoint", ("best", "last")),
        ("set", ("test", "validation", "train")),
    ):
        if config.eval[key] not in allowed:
            raise ConfigError(
                f"eval.{key} must be one of {', '.join(allowed)}; got {config.eval[key]}"
            )
    if not 0.0 < config.eval.level < 1.0:
        raise ConfigError(f"eval.level must lie between 0 and 1; got {config.eval.level}")
    if config.eval.workers < 1:
        raise ConfigError(f"eval.workers must be at least 1; got {config.eval.workers}")
    check_scenarios(config.eval)
    find_device(config.device)
    if replays_session(config):
        _check_session(config)
    if "train" in config:
        _check_training(config)


def drives_live(config: Any) -> bool:
    """Whether the environment is driven in a process that does not wait for the learner."""
    return str(config.collector.get("_target_", "")).endswith(".LiveCollector")


def replays_session(config: Any) -> bool:
    """Whether the mentor is a recorded session that is to be driven again."""
    return str(config.mentor.get("_target_", "")).endswith(".ReplayMentor")


def names_mentor(config: Any) -> bool:
    """Whether the mentor is among those who drive in a recipe that does not train."""
    driver = config.get("driver", "mentor")  # cloning records the mentor
    return any("mentor" in name for name in ([driver] if isinstance(driver, str) else driver))


def _check_session(config: DictConfig) -> None:
    if "train" not in config:
        if names_mentor(config):
            raise ConfigError(
                "mentor=replay drives the training of recipes/haim.py again and nothing else; "
                "choose another mentor, such as mentor=expert switch=shield"
            )
        return
    if config.mentor.session is None:
        raise ConfigError(
            "mentor.session has no value; give a session file or the folder of a recorded run"
        )
    if not str(config.switch.get("_target_", "")).endswith(".RequestSwitch"):
        raise ConfigError(
            "mentor=replay needs switch=request, because the session says who drove each step"
        )
    if config.collector.get("num_workers", 0):
        raise ConfigError(
            "mentor=replay needs collector=sync: one session was driven in one simulator"
        )


def _check_at_least(settings: Any, group: str, **lowest: int) -> None:
    for key, low in lowest.items():
        if settings[key] < low:
            raise ConfigError(f"{group}.{key} must be at least {low}; got {settings[key]}")


def _check_training(config: DictConfig) -> None:
    train = config.train
    _check_at_least(train, "train", log_every=1, checkpoint_every=1, validate_every=0)
    total, frames = config.total_frames, int(config.collector.get("frames_per_batch", 1))
    if not 1 <= frames <= total:
        raise ConfigError(
            f"collector.frames_per_batch must lie between 1 and total_frames ({total}); "
            f"got {frames}"
        )
    if total % frames:
        raise ConfigError(
            f"total_frames ({total}) must be a multiple of collector.frames_per_batch ({frames}); "
            f"use total_frames={total // frames * frames}"
        )
    if config.eval.checkpoint == "best" and train.validate_every == 0:
        raise ConfigError(
            "eval.checkpoint=best needs validations; set train.validate_every above 0 or "
            "eval.checkpoint=last"
        )
    if "replay" in config:
        _check_replay(config)
    if "discriminator" in config:
        _check_on_policy(config)


def _check_replay(config: DictConfig) -> None:
    train, total = config.train, config.total_frames
    _check_at_least(train, "train", batch_size=1, learning_starts=0, no_takeover_after=1)
    if train.updates_per_step <= 0.0:
        raise ConfigError(f"train.updates_per_step must be positive; got {train.updates_per_step}")
    if train.max_grad_norm is not None and train.max_grad_norm <= 0.0:
        raise ConfigError(
            f"train.max_grad_norm must be positive, or null for none; got {train.max_grad_norm}"
        )
    if train.learning_starts >= total:
        raise ConfigError(
            f"train.learning_starts ({train.learning_starts}) must be below total_frames ({total}),"
            " or nothing is ever learned"
        )
    capacity = config.replay.get("capacity")
    if capacity is not None and capacity < train.batch_size:
        raise ConfigError(
            f"replay.capacity ({capacity}) must be at least train.batch_size ({train.batch_size})"
        )


def _check_on_policy(config: DictConfig) -> None:
    if config.cost_limit < 0.0:
        raise ConfigError(f"cost_limit must be at least 0; got {config.cost_limit}")
    if drives_live(config):
        raise ConfigError(
            "collector=live does not wait for the learner, and an on-policy learner must not be "
            "behind; use collector=sync or collector=parallel"
        )
    if config.collector.get("init_random_frames", 0):
        raise ConfigError(
            "collector.init_random_frames must be 0: an on-policy learner learns from what its own "
            f"policy drove; got {config.collector.init_random_frames}"
        )
    if config.record:
        raise ConfigError("record=true writes down who drove, and here nobody takes over; leave it")
    imitates = str(config.algorithm.get("_target_", "")).endswith(".GAILLearner")
    if imitates and config.demonstrations is None:
        raise ConfigError(
            "demonstrations has no value; algorithm=gail needs the id or the folder of a Minari "
            "dataset"
        )
    if config.demonstrations is not None and not imitates:
        raise ConfigError(
            f"demonstrations={config.demonstrations} is given, but this algorithm imitates nobody; "
            "use algorithm=gail"
        )


@functools.cache
def find_device(name: str) -> torch.device:
    """The device called ``cpu``, ``cuda``, ``cuda:1`` or ``auto``.

    Raises:
        ConfigError: If there is no such device here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise ConfigError(f"device must be cpu, cuda or auto; got {name}") from None
    if device.type == "cuda" and (
        not torch.cuda.is_available() or (device.index or 0) >= torch.cuda.device_count()
    ):
        raise ConfigError(f"device is {name} but torch finds no such GPU here; use device=cpu")
    if device.type not in ("cpu", "cuda"):
        raise ConfigError(f"device must be cpu, cuda or auto; got {name}")
    return device


def plain(config: Any) -> dict[str, Any]:
    """A group's settings as plain Python values, interpolations resolved."""
    contents = (
        OmegaConf.to_container(config, resolve=True) if OmegaConf.is_config(config) else config
    )
    if not isinstance(contents, Mapping):
        raise ConfigError(f"expected a group of settings; got {contents!r}")
    return {str(key): value for key, value in contents.items()}
