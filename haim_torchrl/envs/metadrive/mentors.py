"""MetaDrive's own two drivers as mentors: its IDM driver and the PPO expert that it ships.

:class:`~haim_torchrl.mentors.expert.ExpertMentor`, which drives here, too, is the mentor of all
published figures.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from metadrive.examples.ppo_expert import numpy_expert
from metadrive.policy.idm_policy import IDMPolicy
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.envs.metadrive.car import of_metadrive, to_metadrive
from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator


def _action(simulator: MetaDriveSimulator, steering: float, throttle: float) -> Tensor:
    """Our action of MetaDrive's, [2]; what exceeds the AV's limits is cut off."""
    command = of_metadrive(simulator.agent, steering, throttle)
    action = simulator.road.av.model.action(*command)
    return torch.tensor(action, dtype=torch.float32).clamp(-1.0, 1.0)


class IDMMentor:
    """The driver that MetaDrive gives to its traffic: IDM, and MOBIL lane changes."""

    def reset(self, simulator: MetaDriveSimulator) -> None:
        """Begin with the episode's car."""
        self._policy = IDMPolicy(simulator.agent, random_seed=simulator.scenario_labels().index)

    def act(
        self, simulator: MetaDriveSimulator, tensordict: TensorDictBase | None = None
    ) -> Tensor:
        """Its action, [2] in [-1, 1]: pedal, steering."""
        return _action(simulator, *self._policy.act())


class PPOExpertMentor:
    """The policy that MetaDrive ships, trained with PPO on its own observation."""

    def reset(self, simulator: MetaDriveSimulator) -> None:
        """Nothing to forget."""

    def act(
        self, simulator: MetaDriveSimulator, tensordict: TensorDictBase | None = None
    ) -> Tensor:
        """The mean of its distribution, [2] in [-1, 1]: pedal, steering."""
        mean, _ = self._distribution(simulator)
        return _action(simulator, *mean.tolist())

    def density(
        self, simulator: MetaDriveSimulator, tensordict: TensorDictBase | None, action: Tensor
    ) -> float:
        """Density of `action` relative to that of the mean, in (0, 1]."""
        mean, deviation = self._distribution(simulator)
        command = simulator.road.av.model.command(*action.tolist())
        taken = np.array(to_metadrive(simulator.agent, *command))
        offsets = (taken - np.clip(mean, -1.0, 1.0)) / deviation
        return math.exp(-0.5 * float((offsets**2).sum()))

    @staticmethod
    def _distribution(simulator: MetaDriveSimulator) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation, [2] each, in MetaDrive's order: steering, throttle."""
        mean, hidden = numpy_expert.expert(simulator.agent, deterministic=True, need_obs=True)
        weights = np.load(numpy_expert.ckpt_path)
        for layer in ("fc_1", "fc_2"):
            name = f"default_policy/{layer}"
            hidden = np.tanh(hidden @ weights[f"{name}/kernel"] + weights[f"{name}/bias"])
        out = hidden @ weights["default_policy/fc_out/kernel"]
        out = (out + weights["default_policy/fc_out/bias"]).reshape(-1)
        return mean, np.exp(out[2:])
