"""Factories: the world as a Gymnasium and as a TorchRL environment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from torchrl.envs import EnvBase

from haim_torchrl.envs.driving import as_torch_env
from haim_torchrl.envs.platoon_env import PlatoonEnv


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
    """The world as a TorchRL environment; see :func:`~haim_torchrl.envs.driving.as_torch_env`.

    Args:
        **config: settings, see :class:`~haim_torchrl.envs.PlatoonConfig`.
    """
    return as_torch_env(PlatoonEnv(config))
