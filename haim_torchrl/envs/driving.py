"""Any driving simulator as a TorchRL environment, with the same keys whichever it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase, GymWrapper
from torchrl.envs.gym_like import BaseInfoDictReader

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.switches.protocol import Forecast

FLOATS = ("speed", "acceleration", "progress", "cost")
FLAGS = ("success", "crash", "out_of_road", "wrong_way")
PLATOON = ("follower_gaps", "follower_speeds")


class DrivingSimulator(Protocol):
    """What a simulator offers, to take part as a world.

    It is a Gymnasium environment with 0.1 s steps and actions (acceleration, steering) in [-1, 1]²,
    steering positive to the right. Its observations are one vector, or a dict of arrays, each of
    which becomes an entry. ``reset(seed=k)`` makes scenario k; without a seed a scenario of the
    configured set is drawn. Both ``reset`` and ``step`` report in their info: ``speed`` [m/s],
    ``acceleration`` measured over the step [m/s²] and 0 in a crash, ``progress`` in [0, 1],
    ``cost`` (+1 a collision), ``success``, ``crash``, ``out_of_road``, ``wrong_way``, and arrays
    ``follower_gaps`` [m] and ``follower_speeds`` [m/s] of shape [N], float32.

    A simulator that cannot make a scenario of every number has a method ``seed_draws(seed)``, too,
    which seeds the generator that scenarios of the set are drawn with.

    Attributes:
        followers: N.
        minimum_acceleration: strongest braking of the AV [m/s²], negative.
        reflection: what a mirror does to observations and actions; None without such a symmetry.
    """

    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]

    @property
    def followers(self) -> int: ...

    @property
    def minimum_acceleration(self) -> float: ...

    @property
    def reflection(self) -> Reflection | None: ...

    def forecast(self, action: np.ndarray) -> Forecast:
        """Where an action leads; see :class:`~haim_torchrl.switches.protocol.Forecast`."""
        ...

    def snapshot(self) -> Snapshot:
        """The scene now."""
        ...

    def road_polylines(self) -> list[RoadLine]:
        """The lines of the present road network."""
        ...

    def scenario_labels(self) -> ScenarioLabels:
        """Number, block types and obstacles of the present scenario."""
        ...


class DrivingInfoReader(BaseInfoDictReader):
    """Carries a simulator's info entries over into the tensordict, with their specs.

    TorchRL's default reader fails on Python floats and bools, which simulators report.

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
    """A simulator's info entries as tensors, [1] each and [N] for those of the followers."""
    entries = {key: torch.full((1,), info[key], dtype=torch.float32) for key in FLOATS}
    entries |= {key: torch.full((1,), info[key], dtype=torch.bool) for key in FLAGS}
    return entries | {key: torch.from_numpy(info[key]) for key in PLATOON}


class DrivingTorchEnv(GymWrapper):
    """TorchRL's Gymnasium wrapper, with a step that writes the known entries directly.

    The generic wrapper finds out anew at each step what the simulator returned; that costs about
    as much as simulating. Specs, seeding and resets are TorchRL's own, except that an entry
    ``state`` of a dict observation keeps its name, which TorchRL would change to ``observation``.
    """

    observation_spec: Composite

    def _make_specs(self, env: gym.Env, batch_size: torch.Size | None = None) -> None:
        super()._make_specs(env, batch_size)
        names = getattr(env.observation_space, "spaces", {})
        if "state" in names and "observation" not in names:
            spec = self.observation_spec.clone()
            spec["state"] = spec["observation"]
            del spec["observation"]
            self.observation_spec = spec

    def read_obs(self, observations: Any) -> dict[str, Any]:
        if not isinstance(observations, Mapping):
            return super().read_obs(observations)
        return {key: torch.from_numpy(value) for key, value in observations.items()}

    def _set_seed(self, seed: int | None) -> None:
        """Seed the draws of scenarios; where any number is a scenario, begin with that one."""
        seed_draws = getattr(self._env.unwrapped, "seed_draws", None)
        if seed_draws is None:
            super()._set_seed(seed)
        else:
            seed_draws(seed)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict.get("action").numpy()
        observation, reward, terminated, truncated, info = self._env.step(action)
        if not isinstance(observation, dict):
            observation = {"observation": observation}
        entries = self.read_obs(observation)
        entries |= {
            "reward": torch.full((1,), reward, dtype=torch.float32),
            "done": torch.full((1,), terminated or truncated, dtype=torch.bool),
            "terminated": torch.full((1,), terminated, dtype=torch.bool),
            "truncated": torch.full((1,), truncated, dtype=torch.bool),
        }
        entries |= read_info(info)
        return TensorDict(entries, batch_size=[])


def as_torch_env(simulator: Any) -> EnvBase:
    """A simulator (:class:`DrivingSimulator`) as a TorchRL environment, on the CPU.

    Returns:
        An environment with the entries ``observation`` [D] (or those of a dict observation),
        ``speed``, ``acceleration``, ``progress``, ``cost`` [1], ``success``, ``crash``,
        ``out_of_road``, ``wrong_way`` [1] bool, ``follower_gaps``, ``follower_speeds`` [N], at root
        and under ``next``.
    """
    env = DrivingTorchEnv(simulator)
    env.set_info_dict_reader(DrivingInfoReader(simulator.followers))
    return env
