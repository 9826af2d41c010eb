"""The X+1+N world on highway-env: roads, traffic, obstacles, the AV and its followers."""

from gymnasium.envs.registration import register

from haim_torchrl.envs.config import PlatoonConfig
from haim_torchrl.envs.factory import make_env, make_gym_env
from haim_torchrl.envs.observation import ObservationConfig
from haim_torchrl.envs.platoon_env import PlatoonEnv
from haim_torchrl.envs.scenario import Scenario, ScenarioConfig, generate_scenario

register(
    id="haim_torchrl/Platoon-v0",
    entry_point="haim_torchrl.envs.platoon_env:PlatoonEnv",
    disable_env_checker=True,
    order_enforce=False,
)

__all__ = [
    "ObservationConfig",
    "PlatoonConfig",
    "PlatoonEnv",
    "Scenario",
    "ScenarioConfig",
    "generate_scenario",
    "make_env",
    "make_gym_env",
]
