"""A one-step problem in which everything about a policy is known."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import make_value
from haim_torchrl.objectives.on_policy import OnPolicyLearner


def drive(
    actor: ProbabilisticActor,
    steps: int,
    *,
    observe: Callable[[int], Tensor] = lambda steps: torch.ones(steps, 1),
    reward: Callable[[Tensor], Tensor] = lambda action: action,
    cost: Callable[[Tensor], Tensor] = lambda action: action.square(),
) -> TensorDictBase:
    """Episodes of one step each: action in [-1, 1], by default reward a and cost a²."""
    seen = TensorDict(observation=observe(steps), batch_size=[steps])
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        action = actor(seen)["action"]
    ended = torch.ones(steps, 1, dtype=torch.bool)
    after = {
        "observation": seen["observation"].clone(),
        "reward": reward(action),
        "cost": cost(action),
        "done": ended,
        "terminated": ended.clone(),
    }
    root = {"observation": seen["observation"], "action": action}
    return TensorDict({**root, "next": after}, batch_size=[steps])


#: Makes a value network of the right size.
make_small_value = partial(make_value, 1, (8,))


def train(
    learner: OnPolicyLearner, rounds: int, steps: int = 256, **problem: Callable[..., Tensor]
) -> TensorDictBase:
    """Drives and learns by turns; what the policy does at the end."""
    for _ in range(rounds):
        for _ in learner.learn(drive(learner.actor, steps, **problem)):
            pass
    return drive(learner.actor, 2000, **problem)["next"]
