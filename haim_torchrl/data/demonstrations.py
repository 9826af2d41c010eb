"""Demonstrations: what somebody does who drives alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.data.minari_format import OUTCOMES
from haim_torchrl.transforms.worker import simulator_of


class Demonstrator(Protocol):
    """The part of a mentor that a recording needs."""

    def reset(self, simulator: Any) -> None:
        """Begin an episode."""
        ...

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """Action ``[A]`` in [-1, 1]."""
        ...


def drive_demonstrations(
    make_env: Callable[[], EnvBase],
    mentor: Demonstrator,
    steps: int,
    scenarios: Sequence[int],
    *,
    seed: int = 0,
    observation_keys: Sequence[str] = ("observation",),
    simulator: Callable[[EnvBase], Any] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> Iterator[tuple[int, TensorDict]]:
    """Let a mentor drive scenarios in random order, and hand out each episode as it ends.

    Args:
        make_env: Builds the environment, without an intervention transform.
        mentor: Drives every step.
        steps: Number of steps to drive; the last episode may be cut.
        scenarios: Seeds to draw from; each is driven once before any is driven again.
        seed: Seed of the order.
        observation_keys: What of the state is kept.
        simulator: Finds the simulator in the base environment; by default the unwrapped gym
            environment, or the base environment itself if it wraps none.
        on_step: Called with the number of steps so far.

    Yields:
        The scenario, and its transitions ``[T]`` in the form of the replay, each driven by the
        mentor: the observation keys, ``action``, ``action_agent`` and ``action_mentor`` (all three
        the same), ``intervention`` (true), ``takeover_start`` (true in the first step), and under
        ``next`` the observation keys, ``reward``, ``done``, ``terminated``, ``truncated``,
        ``takeover_cost`` (0: nothing was rejected) and those of ``disturbance_cost``, ``cost`` and
        ``success`` that the environment writes.

    Raises:
        ValueError: If there is nothing to drive.
    """
    if steps < 1:
        raise ValueError(f"steps must be at least 1; got {steps}")
    if not scenarios:
        raise ValueError("drive_demonstrations needs at least one scenario; got none")
    generator = torch.Generator().manual_seed(seed)
    env = make_env()
    base = env
    while isinstance(base, TransformedEnv):
        base = base.base_env
    world = (simulator or simulator_of)(base)
    order: list[int] = []
    count = 0
    try:
        while count < steps:
            order = order or torch.randperm(len(scenarios), generator=generator).tolist()
            scenario = int(scenarios[order.pop(0)])
            state = env.reset(seed=scenario)
            mentor.reset(world)
            rows: list[TensorDict] = []
            finished = False
            while not finished and count < steps:
                state.set("action", mentor.act(world, state))
                state = env.step(state)
                rows.append(_transition(state, observation_keys, first=not rows))
                finished = bool(state["next", "done"].any())
                state = step_mdp(state)
                count += 1
                if on_step is not None:
                    on_step(count)
            yield scenario, torch.stack(rows).contiguous()
    finally:
        env.close()


def _transition(step: TensorDictBase, observation_keys: Sequence[str], first: bool) -> TensorDict:
    following = step["next"]
    kept = (*observation_keys, "reward", "done", "terminated", "truncated", *OUTCOMES)
    entries: dict[str, Any] = {key: step[key] for key in observation_keys}
    entries |= dict.fromkeys(("action", "action_agent", "action_mentor"), step["action"])
    done = following["done"]
    after = {key: value for key in kept if (value := following.get(key, None)) is not None}
    after["takeover_cost"] = torch.zeros_like(step["next", "reward"])
    entries |= {
        "intervention": torch.ones_like(done),
        "takeover_start": torch.full_like(done, first),
        "next": after,
    }
    return TensorDict(entries, batch_size=step.batch_size)


def record_demonstrations(
    make_env: Callable[[], EnvBase],
    mentor: Demonstrator,
    steps: int,
    scenarios: Sequence[int],
    **options: Any,
) -> TensorDict:
    """Let a mentor drive scenarios in random order and keep what it saw and did.

    Args:
        make_env: Builds the environment, without an intervention transform.
        mentor: Drives every step.
        steps: Number of steps to record; the last episode may be cut.
        scenarios: Seeds to draw from; each is driven once before any is driven again.
        **options: Of :func:`drive_demonstrations`.

    Returns:
        ``[steps]`` transitions, episode after episode, as :func:`drive_demonstrations` has them.

    Raises:
        ValueError: If there is nothing to drive.
    """
    driven = drive_demonstrations(make_env, mentor, steps, scenarios, **options)
    return TensorDict.cat([episode for _, episode in driven])
