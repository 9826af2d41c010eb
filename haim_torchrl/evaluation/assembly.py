"""From settings to parts: environments, the actor, loggers, drivers."""

from __future__ import annotations

import os
import random
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from hydra.utils import get_method, instantiate
from omegaconf import DictConfig, OmegaConf
from tensordict import NestedKey
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.modules import ProbabilisticActor

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.data.session import SESSION_FILE, SessionError, next_free, read_session
from haim_torchrl.evaluation.config import (
    ConfigError,
    check_config,
    drives_live,
    find_device,
    plain,
    replays_session,
    scenario_set,
)
from haim_torchrl.evaluation.drivers import (
    Driver,
    PolicyDriver,
    RandomDriver,
    StraightDriver,
    simulator_of,
)
from haim_torchrl.evaluation.person import check_person
from haim_torchrl.evaluation.schema import ScenarioSet
from haim_torchrl.evaluation.training_log import ScalarLogger
from haim_torchrl.transforms import InterventionTransform, SessionRecorder, TakeoverToTransition


def build(node: Any, *args: Any, **kwargs: Any) -> Any:
    """Instantiate a part from its settings.

    Args:
        node: Settings with ``_target_``. With ``_partial_`` and arguments here, the partial is
            called with them.
        *args: Positional arguments of the part.
        **kwargs: Keyword arguments of the part.

    Raises:
        ConfigError: In one sentence, if the part refuses its settings or cannot be found.
    """
    contents = plain(node)
    target = contents.get("_target_", "?")
    try:
        part = instantiate(contents, _convert_="all")
        return part(*args, **kwargs) if contents.get("_partial_") and (args or kwargs) else part
    except InstantiationException as error:
        cause: BaseException = error
        while cause.__cause__ is not None:
            cause = cause.__cause__
        raise _refused(target, cause) from error
    except (TypeError, ValueError, KeyError, RuntimeError) as error:
        raise _refused(target, error) from error


def _refused(target: str, cause: BaseException) -> ConfigError:
    if isinstance(cause, ConfigError):
        return cause
    reason = cause.args[0] if isinstance(cause, KeyError) and cause.args else cause
    text = " ".join(str(reason).split())
    return ConfigError(f"{target} cannot be built with its settings: {text}")


def prepare(config: DictConfig) -> torch.device:
    """Check the settings, seed everything random, and find the device.

    Returns:
        Where networks and updates compute.
    """
    check_config(config)
    check_person(config)
    if replays_session(config) and "total_frames" in config:
        _check_length(config)
    torch.set_num_threads(config.threads)
    random.seed(config.seed)
    np.random.seed(config.seed % 2**32)
    torch.manual_seed(config.seed)
    return find_device(config.device)


def _check_length(config: DictConfig) -> None:
    try:
        session = read_session(config.mentor.session)
    except SessionError as error:
        raise ConfigError(str(error)) from error
    if len(session) < config.total_frames:
        raise ConfigError(
            f"session {session.path} ends after {len(session)} steps and total_frames is "
            f"{config.total_frames}; use total_frames of at most the former"
        )


@dataclass(frozen=True)
class World:
    """Builds environments; plain data, so that it travels to other processes.

    Attributes:
        env: Settings of the environment.
        disturbance: Settings of the disturbance transform.
        scenarios: Scenarios that resets draw from.
        mentor: Settings of the mentor.
        switch: Settings of the switch; None for an environment without takeovers.
        takeover_cost: Cost of a takeover's first step, such as ``"cosine"``.
        record: Arguments of the recorder that writes down what is driven; None for none.
    """

    env: Mapping[str, Any]
    disturbance: Mapping[str, Any]
    scenarios: ScenarioSet
    mentor: Mapping[str, Any]
    switch: Mapping[str, Any] | None = None
    takeover_cost: Any = "cosine"
    record: Mapping[str, Any] | None = None

    @classmethod
    def of(cls, config: DictConfig, scenarios: str, *, takeovers: bool) -> World:
        """The world of a run.

        Args:
            config: Settings of the run.
            scenarios: ``"train"``, ``"validation"`` or ``"test"``.
            takeovers: Whether the mentor may take over.
        """
        env = plain(config.env)
        if scenarios != "train" and config.eval.horizon is not None:
            env["horizon"] = config.eval.horizon
        return cls(
            env=env,
            disturbance=plain(config.loss.implicit.cost),
            scenarios=scenario_set(config.eval[scenarios]),
            mentor=plain(config.mentor),
            switch=plain(config.switch) if takeovers else None,
            takeover_cost=config.loss.explicit.cost,
        )

    def __call__(self) -> EnvBase:
        """A new environment.

        The environment's settings are completed by ``first_scenario`` and ``scenarios``, the set
        that resets without a seed draw from. A simulator that says how hard it can brake
        (``minimum_acceleration``) is held against the threshold of a disturbance.
        """
        base = build(self.env, first_scenario=self.scenarios.start, scenarios=self.scenarios.count)
        hardest = getattr(simulator_of(base), "minimum_acceleration", None)
        disturbance = build({**self.disturbance, "min_acceleration": hardest})
        env = TransformedEnv(base)
        try:
            if self.switch is not None:
                mentor, switch = partial(build, self.mentor), partial(build, self.switch)
                env.append_transform(InterventionTransform(mentor, switch, cost=self.takeover_cost))
            env.append_transform(disturbance)
            if self.record is not None:
                env.append_transform(SessionRecorder(**self.record))
            env.observation_spec  # noqa: B018  the transforms look at it here, not later
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            base.close()
            raise _refused("env", error) from error
        return env

    @property
    def one_per_process(self) -> bool:
        """Whether a process can hold only one of these environments, as with MetaDrive."""
        return getattr(get_method(self.env["_target_"]), "one_per_process", False)

    def seeds(self) -> range:
        """Seeds of its scenarios."""
        return self.scenarios.seeds()

    def recorded(self, config: DictConfig) -> World:
        """The same world, which writes what is driven in it to the run's folder (``record``)."""
        if not config.record:
            return self
        live = drives_live(config)
        path = Path(HydraConfig.get().runtime.output_dir) / SESSION_FILE
        return replace(
            self,
            record={
                # A live run goes on with a new file: what a person drove is never cut off.
                "path": next_free(path) if live else path,
                "process": None if live else os.getpid(),
                "seed": config.seed,
                "settings": OmegaConf.to_yaml(config),
            },
        )

    def without_mentor(self) -> World:
        """The same world with nobody to take over."""
        return replace(self, switch=None, record=None)


@dataclass(frozen=True)
class Sizes:
    """What networks and losses need to know of an environment.

    Attributes:
        observation: Size D of the observation; where it is several entries, their shapes by name.
        action: Size A of the action.
        reflection: What a mirror does to both; None where the simulator has no such symmetry.
        entries: What a transition of it holds; empty where no mentor can take over.
    """

    observation: int | Mapping[str, tuple[int, ...]]
    action: int
    reflection: Reflection | None = None
    entries: frozenset[NestedKey] = frozenset()

    @classmethod
    def of(cls, env: EnvBase) -> Sizes:
        """Sizes of an environment."""
        simulator = simulator_of(env)
        return cls(
            _observation(env, simulator),
            env.action_spec.shape[-1],
            getattr(simulator, "reflection", None),
            _entries(env),
        )

    @classmethod
    def of_world(cls, world: World) -> Sizes:
        """Sizes in a world; builds an environment, and so tells early what it cannot do.

        It is built in another process if it would be the only one that this process may have.
        """
        if world.one_per_process:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                return pool.submit(cls._of_new, world).result()
        return cls._of_new(world)

    @classmethod
    def _of_new(cls, world: World) -> Sizes:
        env = world()
        try:
            return cls.of(env)
        finally:
            env.close()


def _observation(env: EnvBase, simulator: Any) -> int | dict[str, tuple[int, ...]]:
    entries = getattr(getattr(simulator, "observation_space", None), "spaces", None)
    if entries is None or "observation" in entries:
        return env.observation_spec["observation"].shape[-1]
    return {key: tuple(space.shape) for key, space in entries.items()}


def _entries(env: EnvBase) -> frozenset[NestedKey]:
    step = env.fake_tensordict()
    if ("next", "intervention") not in step.keys(True, True):
        return frozenset()
    return frozenset(TakeoverToTransition()(step).keys(True, True))


def build_actor(config: DictConfig, sizes: Sizes, device: torch.device) -> ProbabilisticActor:
    """The one actor of a run."""
    return build(config.actor, sizes.observation, sizes.action, device=device)


def build_logger(config: DictConfig) -> ScalarLogger | None:
    """The logger beside the CSV files, or None.

    Raises:
        ConfigError: If its package is not installed.
    """
    if not config.logger:
        return None
    try:
        return build(config.logger)
    except ConfigError as error:
        raise ConfigError(f"{error}; install what it needs, or use logger=csv") from error


def build_driver(name: str, actor: ProbabilisticActor | None, config: DictConfig) -> Driver:
    """A driver by name.

    Args:
        name: ``policy``, ``policy+mentor``, ``mentor``, ``random`` or ``straight``.
        actor: The policy; needed for the first two.
        config: Settings of the run.

    Raises:
        ConfigError: If the name is unknown, or there is no policy.
    """
    if name in ("policy", "policy+mentor"):
        if actor is None:
            raise ConfigError(f"driver={name} needs a policy; give checkpoint=<run folder>")
        return PolicyDriver(actor)
    if name == "mentor":
        return build(config.mentor)
    if name == "random":
        return RandomDriver(seed=config.seed)
    if name == "straight":
        return StraightDriver()
    raise ConfigError(
        f"driver must be policy, policy+mentor, mentor, random or straight; got {name}"
    )
