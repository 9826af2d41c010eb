"""Factories: the world as a Gymnasium and as a TorchRL environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase, GymWrapper
from torchrl.envs.gym_like import BaseInfoDictReader

from haim_torchrl.envs.platoon_env import PlatoonEnv

FLOATS = ("speed", "acceleration", "progress", "cost")
FLAGS = ("success", "crash", "out_of_road", "wrong_way")
PLATOON = ("follower_gaps", "follower_speeds")


class PlatoonInfoReader(BaseInfoDictReader):
    """Carries the world's info entries over into the tensordict, with their specs.

    TorchRL's default reader fails on Python floats and bools, which highway-env reports.

    Args:
        followers: N; shape of the follower entries.
    """

    def __init__(self, followers: int) -> None:
        spec: dict[str, Any] = {key: Unbounded((1,)) for key in FLOATS}
        spec |= {key: Binary(1, (1,), dtype=torch.bool) for key in FLAGS}
        spec |= {key: Unbounded((followers,)) for key in PLATOON}
        self._spec = Composite(spec, shape=[])

    @property
    def info_spec(self) -> dict[str, Any]:
        """Specs of the entries."""
        return dict(self._spec.items())

    def reset(self) -> None:
        """The reader keeps nothing between episodes."""

    def __call__(self, info: dict[str, Any], tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.update(read_info(info))


def read_info(info: Mapping[str, Any]) -> dict[str, Tensor]:
    """The world's info entries as tensors, [1] each and [N] for those of the followers."""
    entries = {key: torch.full((1,), info[key], dtype=torch.float32) for key in FLOATS}
    entries |= {key: torch.full((1,), info[key], dtype=torch.bool) for key in FLAGS}
    return entries | {key: torch.from_numpy(info[key]) for key in PLATOON}


class PlatoonTorchEnv(GymWrapper):
    """TorchRL's Gymnasium wrapper, with a step that writes the known entries directly.

    The generic wrapper finds out anew at each step what the simulator returned; that costs about
    as much as simulating. Specs, seeding and resets are TorchRL's own.
    """

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get("action").numpy()
        observation, reward, terminated, truncated, info = self._env.step(action)
        entries = {
            "observation": torch.from_numpy(observation),
            "reward": torch.full((1,), reward, dtype=torch.float32),
            "done": torch.full((1,), terminated or truncated, dtype=torch.bool),
            "terminated": torch.full((1,), terminated, dtype=torch.bool),
            "truncated": torch.full((1,), truncated, dtype=torch.bool),
        }
        entries |= read_info(info)
        return TensorDict(entries, batch_size=[])


def make_gym_env(
    config: Mapping[str, Any] | None = None, render_mode: str | None = None
) -> gym.Env:
    """The world as a registered Gymnasium environment.

    Args:
        config: settings, see :class:`~haim_torchrl.envs.PlatoonConfig`.
        render_mode: None or "rgb_array".
    """
    return gym.make("haim_torchrl/Platoon-v0", config=dict(config or {}), render_mode=render_mode)


def make_env(**config: Any) -> EnvBase:
    """The world as a TorchRL environment. It and its tensors live on the CPU.

    Args:
        **config: settings, see :class:`~haim_torchrl.envs.PlatoonConfig`.

    Returns:
        An environment with the entries ``observation`` [D], ``speed``, ``acceleration``,
        ``progress``, ``cost`` [1], ``success``, ``crash``, ``out_of_road``, ``wrong_way`` [1] bool,
        ``follower_gaps``, ``follower_speeds`` [N], at root and under ``next``.
    """
    simulator = PlatoonEnv(config)
    env = PlatoonTorchEnv(simulator)
    env.set_info_dict_reader(PlatoonInfoReader(simulator.settings.followers))
    return env
