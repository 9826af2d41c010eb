"""Takeover, its cost and the disturbance of traffic, as transforms of any TorchRL environment."""

from haim_torchrl.transforms.check import check_intervention_specs
from haim_torchrl.transforms.disturbance import DisturbanceTransform
from haim_torchrl.transforms.intervention import InterventionTransform
from haim_torchrl.transforms.keys import (
    REPLAY_KEYS,
    TRANSITION_TABLE,
    DisturbanceKeys,
    InterventionKeys,
    KeyEntry,
)
from haim_torchrl.transforms.random_state import SimulatorRandomState
from haim_torchrl.transforms.recording import SessionRecorder
from haim_torchrl.transforms.shaped_reward import ShapedReward
from haim_torchrl.transforms.transition import TakeoverToTransition

__all__ = [
    "REPLAY_KEYS",
    "TRANSITION_TABLE",
    "DisturbanceKeys",
    "DisturbanceTransform",
    "InterventionKeys",
    "InterventionTransform",
    "KeyEntry",
    "SessionRecorder",
    "ShapedReward",
    "SimulatorRandomState",
    "TakeoverToTransition",
    "check_intervention_specs",
]
