"""All transforms that the suite is applied to: this package's, and three of TorchRL's own.

TorchRL's ``ActionScaling``, ``RewardScaling`` and ``StepCounter`` show that the suite asks what
TorchRL's transforms do, and not only what ours happen to do. A new transform gets a case here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias
from uuid import uuid4

import pytest
import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import (
    ActionScaling,
    EnvBase,
    GymEnv,
    RewardScaling,
    StepCounter,
    Transform,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs

from haim_torchrl.envs import make_env
from haim_torchrl.human import Cockpit
from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import ActionSwitch, Hold
from haim_torchrl.traffic import disturbance_cost
from haim_torchrl.transforms import (
    DisturbanceTransform,
    InterventionTransform,
    SessionRecorder,
    ShapedReward,
    SimulatorRandomState,
    TakeoverToTransition,
    check_intervention_specs,
)

Expectation: TypeAlias = Callable[[], AbstractContextManager[Any]]
"""Makes the context in which something is tried."""

works: Expectation = nullcontext


def refuses(error: type[Exception], message: str) -> Expectation:
    """What is tried raises ``error`` with ``message`` (a regular expression) in it."""
    return partial(pytest.raises, error, match=message)


def pendulum(horizon: int) -> EnvBase:
    """A plain Gymnasium environment, one action in [-2, 2] N m."""
    return GymEnv("Pendulum-v1", max_episode_steps=horizon)


def platoon(horizon: int) -> EnvBase:
    """The world with followers."""
    return make_env(horizon=horizon)


def nothing(root: TensorDictBase, following: TensorDictBase) -> Mapping[NestedKey, Tensor]:
    return {}


def unchanged(data: TensorDictBase) -> TensorDictBase:
    return data


#: Two steps as an environment with takeovers reports them: the mentor drives the first one with
#: 0.5, where the agent proposed -1, and hands back.
STEPS = TensorDict(
    observation=torch.tensor([[1.0], [2.0]]),
    action=torch.tensor([[-1.0], [0.25]]),
    action_agent=torch.tensor([[0.0], [-1.0]]),
    action_mentor=torch.tensor([[0.0], [0.5]]),
    behavior_action=torch.tensor([[0.0], [0.5]]),
    intervention=torch.tensor([[False], [True]]),
    takeover_start=torch.tensor([[False], [True]]),
    takeover_cost=torch.tensor([[0.0], [2.0]]),
    disturbance=torch.tensor([[True], [False]]),
    disturbance_onset=torch.tensor([[True], [False]]),
    disturbance_cost=torch.tensor([[0.5], [0.0]]),
    next=TensorDict(
        observation=torch.tensor([[2.0], [3.0]]),
        action_agent=torch.tensor([[-1.0], [0.25]]),
        action_mentor=torch.tensor([[0.5], [0.0]]),
        behavior_action=torch.tensor([[0.5], [0.25]]),
        intervention=torch.tensor([[True], [False]]),
        takeover_start=torch.tensor([[True], [False]]),
        takeover_cost=torch.tensor([[2.0], [0.0]]),
        disturbance=torch.tensor([[False], [True]]),
        disturbance_onset=torch.tensor([[False], [True]]),
        disturbance_cost=torch.tensor([[0.0], [0.75]]),
        reward=torch.tensor([[4.0], [-6.0]]),
        batch_size=[2],
    ),
    batch_size=[2],
)
#: The same two steps as documented transitions.
TRANSITIONS = TensorDict(
    observation=torch.tensor([[1.0], [2.0]]),
    action=torch.tensor([[0.5], [0.25]]),
    action_agent=torch.tensor([[-1.0], [0.25]]),
    action_mentor=torch.tensor([[0.5], [0.0]]),
    intervention=torch.tensor([[True], [False]]),
    takeover_start=torch.tensor([[True], [False]]),
    next=TensorDict(
        observation=torch.tensor([[2.0], [3.0]]),
        takeover_cost=torch.tensor([[2.0], [0.0]]),
        disturbance=torch.tensor([[False], [True]]),
        disturbance_onset=torch.tensor([[False], [True]]),
        disturbance_cost=torch.tensor([[0.0], [0.75]]),
        reward=torch.tensor([[4.0], [-6.0]]),
        batch_size=[2],
    ),
    batch_size=[2],
)


@dataclass(frozen=True)
class TransformCase:
    """A transform, and the facts about it that differ from transform to transform.

    Attributes:
        name: of the case.
        make: makes the transform.
        world: makes an environment for it, which cuts episodes off after so many steps.
        check: holds an environment with the transform to its specs.
        published: entries that it adds to the environment, zero at a reset.
        executed: the action that the simulator gets, from the root of a step with the proposed one.
        written: what is under ``next`` beside or instead of what the bare environment puts there,
            from the root and that.
        inside: what becomes of it in an environment of its own.
        around: likewise around a ``SerialEnv`` or ``ParallelEnv``.
        saved_around: what becomes of the state of such an environment.
        twice: what becomes of a copy of it beside the original.
        offline: what becomes of the forward pass without environment.
        data: makes what it is given without environment.
        forward: what the forward pass makes of that; replay does it when it samples.
        inverse: what the inverse makes of it; replay does it when it stores.
        read: an entry of ``data`` that a model behind the transform reads.
    """

    name: str
    make: Callable[[], Transform]
    world: Callable[[int], EnvBase] = pendulum
    check: Callable[[EnvBase], None] = check_env_specs
    published: tuple[NestedKey, ...] = ()
    executed: Callable[[TensorDictBase], Tensor] = lambda root: root["action"]
    written: Callable[[TensorDictBase, TensorDictBase], Mapping[NestedKey, Tensor]] = nothing
    inside: Expectation = works
    around: Expectation = works
    saved_around: Expectation = works
    twice: Expectation = works
    offline: Expectation = works
    data: Callable[[], TensorDictBase] = STEPS.clone
    forward: Callable[[TensorDictBase], TensorDictBase] = unchanged
    inverse: Callable[[TensorDictBase], TensorDictBase] = unchanged
    read: NestedKey = "action"

    def __str__(self) -> str:
        return self.name

    def env(self, horizon: int) -> EnvBase:
        """The environment with the transform in it."""
        return TransformedEnv(self.world(horizon), self.make())


class HomelyMentor(FunctionMentor):
    """Always says 0.5, and stays in the process in which it was built."""

    def __init__(self) -> None:
        super().__init__(lambda simulator, step: [0.5])

    def __reduce__(self) -> Any:
        raise AssertionError("mentors do not travel")


def taken(root: TensorDictBase) -> Tensor:
    return (root["action"] - 0.5).abs() > 1.0


def takeover(root: TensorDictBase, following: TensorDictBase) -> Mapping[NestedKey, Tensor]:
    flag, agent = taken(root), root["action"]
    start = flag & ~root["intervention"]
    return {
        "action_agent": agent,
        "action_mentor": torch.where(flag, 0.5, 0.0),
        "behavior_action": torch.where(flag, 0.5, agent),
        "intervention": flag,
        "takeover_start": start,
        "takeover_cost": torch.where(start & (agent < 0.0), 2.0, 0.0),  # 1 - cos(180 degrees)
    }


def braking(root: TensorDictBase, following: TensorDictBase) -> Mapping[NestedKey, Tensor]:
    acceleration = following["acceleration"]
    hard = acceleration <= -1.0
    onset = hard & (root["acceleration"] > -1.0)
    cost = disturbance_cost(
        root["follower_gaps"], root["follower_speeds"], root["speed"], acceleration
    )
    return {
        "disturbance": hard,
        "disturbance_onset": onset,
        "disturbance_cost": torch.where(onset, cost, 0.0),
    }


def intervention() -> InterventionTransform:
    return InterventionTransform(HomelyMentor, Hold(ActionSwitch(1.0), 1))


def with_shaped_reward(data: TensorDictBase) -> TensorDictBase:
    return data.clone().set(("next", "shaped_reward"), torch.tensor([[2.0], [-7.0]]))


NEEDS_SIMULATOR = refuses(RuntimeError, "needs the simulator.*put the transform inside")
SESSIONS = TemporaryDirectory()

CASES = (
    TransformCase(
        "InterventionTransform",
        intervention,
        check=check_intervention_specs,
        published=(
            "action_agent",
            "action_mentor",
            "behavior_action",
            "intervention",
            "takeover_start",
            "takeover_cost",
        ),
        executed=lambda root: torch.where(taken(root), 0.5, root["action"]),
        written=takeover,
        around=NEEDS_SIMULATOR,
        saved_around=NEEDS_SIMULATOR,
    ),
    TransformCase(
        "DisturbanceTransform",
        lambda: DisturbanceTransform(-1.0),  # m/s²: reached at random from standstill
        world=platoon,
        published=("disturbance", "disturbance_onset", "disturbance_cost"),
        written=braking,
    ),
    TransformCase(
        "TakeoverToTransition",
        TakeoverToTransition,
        inside=refuses(RuntimeError, "finished steps.*postproc"),
        around=refuses(RuntimeError, "finished steps.*postproc"),
        forward=lambda data: TRANSITIONS,
        inverse=lambda data: TRANSITIONS,
    ),
    TransformCase(
        "ShapedReward",
        lambda: ShapedReward(2.0),
        inside=refuses(RuntimeError, "finished steps.*postproc"),
        around=refuses(RuntimeError, "finished steps.*postproc"),
        data=lambda: STEPS.clone().set(("next", "cost"), torch.tensor([[1.0], [0.5]])),
        forward=with_shaped_reward,
        inverse=with_shaped_reward,
    ),
    TransformCase(
        "SimulatorRandomState",
        SimulatorRandomState,
        saved_around=NEEDS_SIMULATOR,
    ),
    TransformCase(
        "SessionRecorder",
        lambda: SessionRecorder(Path(SESSIONS.name) / f"{uuid4()}.jsonl"),
        world=lambda horizon: TransformedEnv(pendulum(horizon), intervention()),
        around=NEEDS_SIMULATOR,
        saved_around=NEEDS_SIMULATOR,
        twice=refuses(FileExistsError, "nothing is overwritten"),
    ),
    TransformCase(
        "Cockpit",
        lambda: Cockpit(None),  # the time that steps take is no property of the transform
        published=("device_ok",),
        written=lambda root, following: {"device_ok": torch.ones_like(following["done"])},
        around=NEEDS_SIMULATOR,
        saved_around=NEEDS_SIMULATOR,
    ),
    TransformCase(
        "ActionScaling",
        lambda: ActionScaling(loc=0.0, scale=2.0),
        executed=lambda root: 2.0 * root["action"],
        forward=lambda data: data.clone().set("action", data["action"] / 2.0),
        inverse=lambda data: data.clone().set("action", data["action"] * 2.0),
    ),
    TransformCase(
        "RewardScaling",
        lambda: RewardScaling(loc=1.0, scale=0.5),
        written=lambda root, following: {"reward": 0.5 * following["reward"] + 1.0},
        data=lambda: STEPS.clone().set("reward", torch.tensor([[4.0], [-6.0]])),
        forward=lambda data: data.clone().set("reward", torch.tensor([[3.0], [-2.0]])),
        read="reward",
    ),
    TransformCase(
        "StepCounter",
        StepCounter,
        published=("step_count",),
        written=lambda root, following: {"step_count": root["step_count"] + 1},
        offline=refuses(NotImplementedError, "cannot be called independently"),
    ),
)
