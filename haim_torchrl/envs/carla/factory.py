"""Factory: the CARLA world as a TorchRL environment."""

from __future__ import annotations

from typing import Any

from torchrl.envs import EnvBase

from haim_torchrl.envs.carla.simulator import CarlaSimulator
from haim_torchrl.envs.driving import as_torch_env


def make_env(**config: Any) -> EnvBase:
    """The CARLA world as a TorchRL environment (:func:`~haim_torchrl.envs.driving.as_torch_env`).

    Args:
        **config: settings, see :class:`~haim_torchrl.envs.carla.CarlaConfig`.
    """
    return as_torch_env(CarlaSimulator(config))
