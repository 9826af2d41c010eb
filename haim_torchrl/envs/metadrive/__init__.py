"""The X+1+N world on MetaDrive, the paper's own simulator; optional."""

from haim_torchrl.envs.metadrive.config import MetaDriveConfig
from haim_torchrl.envs.metadrive.factory import make_env

__all__ = ["MetaDriveConfig", "make_env"]
