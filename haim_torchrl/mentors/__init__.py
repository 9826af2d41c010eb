"""Who can take over: rule-based drivers, trained policies, people."""

from haim_torchrl.mentors.fallible import FallibleMentor
from haim_torchrl.mentors.policy import PolicyMentor
from haim_torchrl.mentors.protocol import (
    DensityMentor,
    DeviceMentor,
    Mentor,
    MentorFactory,
    ProposingMentor,
    RequestingMentor,
    StatefulMentor,
)
from haim_torchrl.mentors.replay import ReplayMentor
from haim_torchrl.mentors.scripted import FunctionMentor

__all__ = [
    "DensityMentor",
    "DeviceMentor",
    "FallibleMentor",
    "FunctionMentor",
    "Mentor",
    "MentorFactory",
    "PolicyMentor",
    "ProposingMentor",
    "ReplayMentor",
    "RequestingMentor",
    "StatefulMentor",
]
