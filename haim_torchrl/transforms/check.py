"""A check to run once on an environment with takeovers, before training on it."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

from haim_torchrl.transforms.keys import InterventionKeys


def check_intervention_specs(
    env: EnvBase, *, keys: InterventionKeys | None = None, steps: int = 20
) -> None:
    """Check that an environment tells who drove, in every step and through resets.

    Runs TorchRL's ``check_env_specs``, then ``steps`` steps of random actions, and holds them to
    what :class:`~haim_torchrl.transforms.InterventionTransform` promises. The environment is
    reset.

    Args:
        env: single, serial or parallel environment with an intervention transform.
        keys: names of the entries.
        steps: number of steps to look at.

    Raises:
        KeyError: an entry is missing from the specs.
        ValueError: the data break a promise, which is named.
        AssertionError: data and specs differ (from ``check_env_specs``).
    """
    keys = keys or InterventionKeys()
    missing = [key for key in keys.published if key not in env.observation_spec.keys(True, True)]
    if missing:
        raise KeyError(
            f"the environment does not publish {missing}: give it an InterventionTransform (each "
            "sub-environment its own), and the same keys here."
        )
    if keys.intervention not in env.full_state_spec.keys(True, True):
        raise KeyError(
            f"{keys.intervention!r} is not a state entry of the environment: a batched "
            "environment would step on with a stale flag."
        )
    check_env_specs(env)
    _check_rollout(env.rollout(steps, break_when_any_done=False), keys)


def _check_rollout(rollout: TensorDictBase, keys: InterventionKeys) -> None:
    """Hold a contiguous rollout, time last, to the promises of the transform."""
    following = rollout["next"]
    flag = following[keys.intervention]
    before = rollout[keys.intervention]
    agent, mentor = following[keys.action_agent], following[keys.action_mentor]
    ended = following["done"][..., :-1, :]
    carried = torch.where(ended, torch.zeros_like(flag[..., :-1, :]), flag[..., :-1, :])
    promises = {
        "the root flag is that of the step before, and False after a reset": torch.equal(
            before[..., 1:, :], carried
        ),
        "takeover_start is set exactly where the flag rises": torch.equal(
            following[keys.takeover_start], flag & ~before
        ),
        "the executed action is the mentor's where it intervenes and the agent's elsewhere": (
            torch.equal(following[keys.behavior_action], torch.where(flag, mentor, agent))
        ),
        "action_mentor is zero where the mentor does not intervene": not torch.where(
            flag, torch.zeros_like(mentor), mentor
        ).any(),
        "action_agent is what the policy proposed": torch.equal(agent, rollout[keys.action]),
        "takeover_cost is zero except where a takeover starts": not following[keys.takeover_cost][
            ~following[keys.takeover_start]
        ].any(),
    }
    for promise, kept in promises.items():
        if not kept:
            raise ValueError(f"the environment breaks a promise: {promise}.")
