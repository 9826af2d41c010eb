"""The X+1+N world in CARLA, for which a server and the extra ``carla`` are needed.

Nothing here imports CARLA's client before it is used.
"""

from haim_torchrl.envs.carla.config import CarlaConfig
from haim_torchrl.envs.carla.factory import make_env
from haim_torchrl.envs.carla.simulator import CarlaSimulator

__all__ = ["CarlaConfig", "CarlaSimulator", "make_env"]
