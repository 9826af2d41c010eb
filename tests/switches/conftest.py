import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import Situation


class ScriptedSwitch:
    """Fires as told, one answer per step, and remembers that it was asked."""

    def __init__(self, answers, memoryless=False):
        self.answers = list(answers)
        self.memoryless = memoryless
        self.asked = 0
        self.resets = 0

    def reset(self):
        self.asked = 0
        self.resets += 1

    def __call__(self, situation):
        self.asked += 1
        return bool(self.answers[self.asked - 1])


@pytest.fixture
def scripted():
    return ScriptedSwitch


@pytest.fixture
def situation():
    """Builds the situation of one step; ``mentor_calls`` counts how often the mentor was asked."""

    def build(agent=(0.0, 0.0), mentor=(0.0, 0.0), simulator=None, was_intervening=False, who=None):
        calls = []

        def act(simulator, tensordict):
            calls.append(1)
            return mentor

        step = Situation(
            simulator,
            TensorDict(observation=torch.zeros(1)),
            torch.tensor(agent, dtype=torch.float32),
            FunctionMentor(act) if who is None else who,
            was_intervening,
        )
        return step, calls

    return build


@pytest.fixture
def run(situation):
    """Runs a switch as an environment does: who drove a step is told to the next."""

    def drive(switch, steps):
        driven, before = [], False
        for _ in range(steps):
            before = bool(switch(situation(was_intervening=before)[0]))
            driven.append(before)
        return driven

    return drive
