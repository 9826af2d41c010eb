"""Demonstrations: what a mentor does when it drives alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.transforms.worker import simulator_of


class Demonstrator(Protocol):
    """The part of a mentor that a recording needs."""

    def reset(self, simulator: Any) -> None:
        """Begin an episode."""
        ...

    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """Action ``[A]`` in [-1, 1]."""
        ...


def record_demonstrations(
    make_env: Callable[[], EnvBase],
    mentor: Demonstrator,
    steps: int,
    scenarios: Sequence[int],
    *,
    seed: int = 0,
    observation_keys: Sequence[str] = ("observation",),
    simulator: Callable[[EnvBase], Any] | None = None,
    on_step: Callable[[int], None] | None = None,
) -> TensorDict:
    """Let a mentor drive scenarios in random order and keep what it saw and did.

    Args:
        make_env: Builds the environment, without an intervention transform.
        mentor: Drives every step.
        steps: Number of steps to record; the last episode may be cut.
        scenarios: Seeds to draw from; each is driven once before any is driven again.
        seed: Seed of the order.
        observation_keys: What of the state is kept.
        simulator: Finds the simulator in the base environment; by default the unwrapped gym
            environment, or the base environment itself if it wraps none.
        on_step: Called with the number of steps so far.

    Returns:
        ``[steps]`` transitions with the observation keys, ``action`` ``[steps, A]`` and ``done``
        ``[steps, 1]``.

    Raises:
        ValueError: If there is nothing to drive.
    """
    if steps < 1:
        raise ValueError(f"steps must be at least 1; got {steps}")
    if not scenarios:
        raise ValueError("record_demonstrations needs at least one scenario; got none")
    generator = torch.Generator().manual_seed(seed)
    rows: list[TensorDict] = []
    env = make_env()
    base = env
    while isinstance(base, TransformedEnv):
        base = base.base_env
    world = (simulator or simulator_of)(base)
    try:
        while len(rows) < steps:
            for index in torch.randperm(len(scenarios), generator=generator).tolist():
                state = env.reset(seed=int(scenarios[index]))
                mentor.reset(world)
                finished = False
                while not finished and len(rows) < steps:
                    state.set("action", mentor.act(world, state))
                    state = env.step(state)
                    finished = bool(state["next", "done"].any())
                    row: dict[str, Tensor] = {key: state[key] for key in observation_keys}
                    row |= {"action": state["action"], "done": state["next", "done"]}
                    rows.append(TensorDict(row, batch_size=state.batch_size))
                    state = step_mdp(state)
                    if on_step is not None:
                        on_step(len(rows))
                if len(rows) >= steps:
                    break
    finally:
        env.close()
    return torch.stack(rows).contiguous()
