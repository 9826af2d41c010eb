"""The MetaDrive world as a TorchRL environment."""

from __future__ import annotations

import importlib.util
from typing import Any

from torchrl.envs import EnvBase

from haim_torchrl.envs.driving import as_torch_env
from haim_torchrl.envs.metadrive.config import MetaDriveConfig


def make_env(**config: Any) -> EnvBase:
    """The world as a TorchRL environment; see :func:`~haim_torchrl.envs.driving.as_torch_env`.

    MetaDrive's engine is a singleton of its process. Close one environment before you make the
    next, or make it in another process.

    Args:
        **config: settings, see :class:`MetaDriveConfig`.

    Raises:
        RuntimeError: MetaDrive is not installed, runs in this process already, or lacks assets.
    """
    settings = MetaDriveConfig.of(config)
    if importlib.util.find_spec("metadrive") is None:
        raise RuntimeError(
            "env=metadrive needs the package metadrive-simulator; install it with: "
            'pip install "haim-torchrl[metadrive]"'
        )
    from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator

    return as_torch_env(MetaDriveSimulator(settings))


make_env.one_per_process = True  # type: ignore[attr-defined]
