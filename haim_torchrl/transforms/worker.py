"""Access from a transform to the simulator that its environment steps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from torchrl.envs import Compose, EnvBase, Transform, TransformedEnv


def worker_env(transform: Transform) -> EnvBase:
    """The base environment of a transform that needs a simulator of its own.

    Args:
        transform: a transform inside a ``TransformedEnv``.

    Returns:
        The innermost environment, without batch dimension.

    Raises:
        RuntimeError: there is no environment, or it stands for several.
    """
    env = transform.container
    name = type(transform).__name__
    if env is None:
        raise RuntimeError(f"{name} works inside an environment: put it in a TransformedEnv.")
    while isinstance(env, TransformedEnv):
        env = env.base_env
    if env.batch_size:
        raise RuntimeError(
            f"{name} needs the simulator, and {type(env).__name__} with batch size "
            f"{tuple(env.batch_size)} stands for several or keeps them in other processes: put "
            "the transform inside, e.g. ParallelEnv(n, lambda: TransformedEnv(GymEnv(...), "
            f"{name}(...)))."
        )
    return env


def transforms_before(transform: Transform) -> Iterator[Transform]:
    """Transforms whose output a transform sees: those before it in its chain, then those inside."""
    env = transform.container
    while isinstance(env, TransformedEnv):
        chain = env.transform
        for other in chain.transforms if isinstance(chain, Compose) else [chain]:
            if other is transform:
                break
            yield other
        env = env.base_env


def simulator_of(env: EnvBase) -> Any:
    """The unwrapped gym environment inside ``env``, or ``env`` itself if it wraps none."""
    wrapped = env.__dict__.get("_env")
    return env if wrapped is None else getattr(wrapped, "unwrapped", wrapped)
