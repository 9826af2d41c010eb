"""Demonstrations as datasets: who may record them, and what is said when they are read."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from datetime import datetime, timezone
from multiprocessing import get_context
from typing import Any

from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict

from haim_torchrl.data.minari import card_of, load_episodes
from haim_torchrl.data.minari_format import MinariError
from haim_torchrl.data.quality import Quality
from haim_torchrl.data.session_writer import package_versions
from haim_torchrl.evaluation.assembly import World
from haim_torchrl.evaluation.config import ConfigError, scenario_set

DRIVERS = ("mentor", "policy", "random", "straight")
"""Who can demonstrate. With a mentor beside the policy it would be takeover data: a session."""


@contextmanager
def dataset_errors() -> Iterator[None]:
    """Turn a dataset that cannot be written or read into bad input, said in one sentence.

    Raises:
        ConfigError: Instead of a MinariError.
    """
    try:
        yield
    except MinariError as error:
        raise ConfigError(str(error)) from error


def check_demonstration(config: DictConfig) -> None:
    """Refuse settings of ``recipes/demonstrate.py`` that contradict each other.

    Raises:
        ConfigError: With one sentence that names the key.
    """
    if config.steps < 1:
        raise ConfigError(f"steps must be at least 1; got {config.steps}")
    if config.driver not in DRIVERS:
        raise ConfigError(f"driver must be one of {', '.join(DRIVERS)}; got {config.driver}")
    if config.checkpoint is not None and config.driver != "policy":
        raise ConfigError(
            f"checkpoint is given, but driver={config.driver} drives; use driver=policy"
        )
    if config.eval.set != "train":
        raise ConfigError(
            f"eval.set is {config.eval.set}, but demonstrations are driven in training scenarios "
            "only: whoever learned from others would have seen what it is measured in; leave "
            "eval.set=train"
        )


def demonstration_card(config: DictConfig, quality: Quality) -> dict[str, Any]:
    """What a dataset says of how it was recorded.

    Args:
        config: Settings of the recording.
        quality: Figures of what was recorded.
    """
    return {
        "statistics": quality.as_dict(),
        "driver": describe_driver(config),
        "observation_view": str(config.env.get("observation", {}).get("view", "unknown")),
        "seed": config.seed,
        "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "settings": OmegaConf.to_yaml(config),
        "versions": package_versions(),
    }


def describe_driver(config: DictConfig) -> str:
    """Who drove, in words."""
    if config.driver == "mentor":
        return str(config.mentor.get("_target_", "a mentor")).rpartition(".")[2]
    return f"the policy of {config.checkpoint}" if config.driver == "policy" else config.driver


def say_quality(what: str, quality: Quality) -> None:
    """Print the figures of demonstrations, and one sentence more if they are no model.

    Args:
        what: What they are of, for the line.
        quality: The figures.
    """
    print(f"{what}: {quality}", flush=True)
    complaint = quality.complaint()
    if complaint is not None:
        print(f"beware: {complaint}", flush=True)


def load_demonstrations(dataset: str, world: World, config: DictConfig) -> TensorDict:
    """Read a dataset to learn from, and say what it is worth.

    Args:
        dataset: Id of a Minari dataset, or its folder.
        world: What is to be learned in.
        config: Settings of the run.

    Returns:
        Its transitions ``[N]``; see :func:`~haim_torchrl.data.minari.load_minari`.

    Raises:
        ConfigError: In one sentence, if the dataset is missing, damaged, not finite, of another
            world, or holds scenarios that this run is measured in.
    """
    with dataset_errors():
        card = card_of(dataset)
        _check_world(dataset, card, config)
        if world.one_per_process:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                episodes = pool.submit(_load, dataset, world).result()
        else:
            episodes = _load(dataset, world)
    say_quality(f"dataset {dataset}", Quality.of(episodes))
    return TensorDict.cat(episodes)


def load_mentor_steps(dataset: str, world: World, config: DictConfig) -> TensorDict:
    """Read the steps of a dataset that show how to drive.

    Of a session that was exported, what the mentor did is a demonstration. What the agent did is
    what it was corrected for.

    Args:
        dataset: Id of a Minari dataset, or its folder.
        world: What is to be learned in.
        config: Settings of the run.

    Returns:
        Its transitions ``[N]`` with ``intervention``, in their order.

    Raises:
        ConfigError: As :func:`load_demonstrations`, or if there is no such step.
    """
    data = load_demonstrations(dataset, world, config)
    shown = data[data["intervention"].squeeze(-1)]
    if not len(shown):
        raise ConfigError(
            f"dataset {dataset} holds no step that a mentor drove, so there is nothing to imitate; "
            "choose another dataset"
        )
    if len(shown) < len(data):
        print(f"dataset {dataset}: a mentor drove {len(shown)} of {len(data)} steps", flush=True)
    return shown


def _load(dataset: str, world: World) -> list[TensorDict]:
    env = world()
    try:
        return load_episodes(dataset, env)
    finally:
        env.close()


def _check_world(dataset: str, card: dict[str, Any], config: DictConfig) -> None:
    settings = OmegaConf.create(card.get("settings") or "")
    for key in ("env._target_", "env.observation"):
        theirs, ours = OmegaConf.select(settings, key), OmegaConf.select(config, key)
        if theirs is not None and theirs != ours:
            raise ConfigError(
                f"dataset {dataset} was recorded with {key}={_short(theirs)}, and this run has "
                f"{_short(ours)}; choose the same env and env/observation, or another dataset"
            )
    for name in ("test", "validation"):
        shared = set(scenario_set(config.eval[name]).seeds()) & set(card["scenarios"])
        if shared:
            raise ConfigError(
                f"dataset {dataset} holds scenarios of eval.{name}, such as {min(shared)}; change "
                f"eval.{name}.start, or choose another dataset"
            )


def _short(value: Any) -> str:
    plain = OmegaConf.to_container(value) if OmegaConf.is_config(value) else value
    return " ".join(str(plain).split())
