"""What a Minari dataset of this project holds: its entries, its spaces, and what is refused."""

from __future__ import annotations

import copy
import dataclasses
import importlib
from types import ModuleType
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Bounded, TensorSpec
from torchrl.envs import EnvBase

CARD = "haim_torchrl"
"""Entry of a dataset's metadata that holds what Minari has no name for."""
WHO_DROVE = ("action_agent", "action_mentor", "intervention", "takeover_start")
OUTCOMES = ("takeover_cost", "disturbance_cost", "cost", "success")
"""Entries under ``next`` that are kept, too, where the environment has them."""
INFOS = {
    "action_agent": "what the agent proposed",
    "action_mentor": "what the mentor did, zeros where it did not drive",
    "intervention": "the mentor drove the step",
    "takeover_start": "first step of a takeover",
    "takeover_cost": "cost of that start",
    "disturbance_cost": "cost of the disturbance of followers",
    "cost": "cost of the environment, such as a collision",
    "success": "the destination was reached",
    "device_ok": "the mentor's input device worked; true for machines",
    "scenario": "seed of the scenario; -1 where the simulator has none",
    "cut": "the record ends here though the episode went on; Minari has it as a truncation",
}
"""Meaning of the infos. Entry 0 belongs to the reset, entry t + 1 to step t, as in Minari."""


class MinariError(ValueError):
    """A dataset that cannot be written or read; the message says why and what to do."""


def find_minari() -> ModuleType:
    """The module minari, which only datasets need.

    Raises:
        MinariError: If it, or the library of its file format, is not installed.
    """
    try:
        importlib.import_module("h5py")
        return importlib.import_module("minari")
    except ImportError as error:
        raise MinariError(
            f"Minari datasets need {error.name}, which is not installed: install "
            "haim-torchrl[minari], with Python 3.11 or newer"
        ) from error


@dataclasses.dataclass(frozen=True)
class Spaces:
    """What a dataset says of the environment that it is of.

    Attributes:
        observation: Gymnasium's box of observations.
        action: Gymnasium's box of actions.
        spec: What gymnasium makes the simulator from; None where that is not known.
    """

    observation: Any
    action: Any
    spec: Any = None

    @classmethod
    def of(cls, env: EnvBase) -> Spaces:
        """Those of an environment.

        Raises:
            MinariError: If its observation or action is no vector of floats.
        """
        if "observation" not in env.observation_spec.keys(True, True):
            raise MinariError(
                "the environment observes several entries, and a dataset holds one vector; choose "
                "an observation of numbers, such as env/observation=numeric"
            )
        seen = _box(env.observation_spec["observation"], "observation")
        return cls(seen, _box(env.action_spec, "action"), _env_spec(env))


def check_ranges(steps: TensorDictBase, observation: Any, action: Any, where: str) -> None:
    """Refuse values that are not finite, or outside of their space.

    Args:
        steps: Transitions, ``[T]``.
        observation: Gymnasium's box of observations.
        action: Gymnasium's box of actions.
        where: What they are of, for the message.

    Raises:
        MinariError: With the name of the field.
    """
    for key, box in (
        ("observation", observation),
        (("next", "observation"), observation),
        ("action", action),
        ("action_agent", action),
        ("action_mentor", None),  # zeros, where it did not drive, need not be an action
        (("next", "reward"), None),
    ):
        name = key if isinstance(key, str) else "next." + key[1]
        values = steps[key].numpy()
        if not np.isfinite(values).all():
            raise MinariError(f"{where}: {name} holds values that are not finite")
        if box is not None and ((values < box.low - 1e-5) | (values > box.high + 1e-5)).any():
            raise MinariError(
                f"{where}: {name} holds values from {values.min():.6g} to {values.max():.6g}, "
                f"outside of its space {box}"
            )


def _box(spec: TensorSpec, name: str) -> Any:
    spaces = importlib.import_module("gymnasium.spaces")
    if not spec.dtype.is_floating_point:
        raise MinariError(f"{name} is {spec.dtype}, and only continuous values can be exported")
    low, high = -np.inf, np.inf
    if isinstance(spec, Bounded):
        low, high = (edge.expand(spec.shape).numpy() for edge in (spec.space.low, spec.space.high))
    dtype = torch.empty(0, dtype=spec.dtype).numpy().dtype
    return spaces.Box(low, high, tuple(spec.shape), dtype.type)


def _env_spec(env: EnvBase) -> Any:
    """What gymnasium makes the simulator from; None where that is not known."""
    from haim_torchrl.envs.platoon_env import PlatoonEnv
    from haim_torchrl.evaluation.drivers import simulator_of

    gym = importlib.import_module("gymnasium")
    simulator = simulator_of(env)
    if isinstance(simulator, PlatoonEnv):
        spec = copy.deepcopy(gym.spec("haim_torchrl/Platoon-v0"))
        spec.kwargs = {"config": dataclasses.asdict(simulator.settings)}
        return spec
    return getattr(simulator, "spec", None)
