"""Storage of takeover data."""

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.data.replay import (
    TRANSITION_KEYS,
    TakeoverReplayBuffer,
    make_replay_buffer,
)
from haim_torchrl.data.store import TransitionStore

__all__ = [
    "TRANSITION_KEYS",
    "Reflection",
    "TakeoverReplayBuffer",
    "TransitionStore",
    "make_replay_buffer",
]
