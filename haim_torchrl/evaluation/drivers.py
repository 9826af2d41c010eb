"""Who may hold the wheel in an evaluation.

A driver has the two methods of a mentor, ``reset(simulator)`` and ``act(simulator, tensordict)``.
A mentor is thus a driver as it stands, and a trained policy becomes one with :class:`PolicyDriver`.
"""

from __future__ import annotations

from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from haim_torchrl.transforms.worker import simulator_of as simulator_inside


class Driver(Protocol):
    """Chooses the action of every step."""

    def reset(self, simulator: Any) -> None:
        """Begin an episode."""
        ...

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """Action ``[A]`` in [-1, 1] for the present state."""
        ...


class PolicyDriver:
    """A policy's deterministic action (decision 17).

    Args:
        actor: Module that reads the observation and writes ``action``.
        device: Where the actor computes; defaults to where its parameters are.
    """

    def __init__(self, actor: TensorDictModuleBase, device: torch.device | None = None) -> None:
        self.actor = actor
        first = next(actor.parameters(), None)
        self.device = device or (first.device if first is not None else torch.device("cpu"))

    def reset(self, simulator: Any) -> None:
        """Nothing to forget: the policy has no memory."""

    @torch.no_grad()
    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """Mode or mean of the policy's distribution, ``[A]``."""
        inputs = TensorDict(
            {key: tensordict.get(key).to(self.device) for key in self.actor.in_keys},
            batch_size=tensordict.batch_size,
        )
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return self.actor(inputs).get("action").cpu()


class RandomDriver:
    """Uniform actions in [-1, 1], the lower end of every comparison.

    Args:
        size: Number of action components.
        seed: Seed; each episode draws its own stream from it.
    """

    def __init__(self, size: int = 2, seed: int = 0) -> None:
        self.size, self._seed = size, seed
        self._generator = torch.Generator().manual_seed(seed)
        self._episode = 0

    def reset(self, simulator: Any) -> None:
        """Begin the next episode's stream."""
        self._episode += 1
        self._generator.manual_seed(self._seed + self._episode)

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """A draw, ``[A]``."""
        return 2.0 * torch.rand(self.size, generator=self._generator) - 1.0


class StraightDriver:
    """Accelerates gently and never steers: what the road alone gives away.

    Args:
        acceleration: Acceleration component of the action; 0.25 is 1 m/s^2 in the platoon's world.
    """

    def __init__(self, acceleration: float = 0.25) -> None:
        self._action = torch.tensor([acceleration, 0.0])

    def reset(self, simulator: Any) -> None:
        """Nothing to forget."""

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """The constant action, ``[2]``."""
        return self._action.clone()


def simulator_of(env: EnvBase) -> Any:
    """The simulator under a TorchRL environment's transforms and wrappers.

    Raises:
        TypeError: If there is none in this process, as with ``ParallelEnv``, or several.
    """
    while isinstance(env, TransformedEnv):
        env = env.base_env
    if env.batch_size:
        raise TypeError(
            f"{type(env).__name__} with batch size {tuple(env.batch_size)} stands for several "
            "simulators; evaluate with an environment around one"
        )
    return simulator_inside(env)
