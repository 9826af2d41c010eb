"""Who can take over: rule-based drivers, trained policies, people."""

from haim_torchrl.mentors.fallible import FallibleMentor
from haim_torchrl.mentors.policy import PolicyMentor
from haim_torchrl.mentors.protocol import (
    DensityMentor,
    Mentor,
    MentorFactory,
    RequestingMentor,
)
from haim_torchrl.mentors.scripted import FunctionMentor

__all__ = [
    "DensityMentor",
    "FallibleMentor",
    "FunctionMentor",
    "Mentor",
    "MentorFactory",
    "PolicyMentor",
    "RequestingMentor",
]
