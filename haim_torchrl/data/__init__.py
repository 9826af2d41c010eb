"""Storage of takeover data."""

from haim_torchrl.data.aggregation import Aggregate
from haim_torchrl.data.reflection import Reflection
from haim_torchrl.data.replay import (
    TRANSITION_KEYS,
    TakeoverReplayBuffer,
    make_replay_buffer,
)
from haim_torchrl.data.session import (
    SESSION_FILE,
    Session,
    SessionEpisode,
    SessionError,
    SessionStep,
    read_session,
)
from haim_torchrl.data.session_writer import SessionWriter
from haim_torchrl.data.store import TransitionStore

__all__ = [
    "SESSION_FILE",
    "TRANSITION_KEYS",
    "Aggregate",
    "Reflection",
    "Session",
    "SessionEpisode",
    "SessionError",
    "SessionStep",
    "SessionWriter",
    "TakeoverReplayBuffer",
    "TransitionStore",
    "make_replay_buffer",
    "read_session",
]
