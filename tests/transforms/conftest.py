"""Pendulum for what concerns any simulator, and one car in front of two followers for the rest.

Environments are built by closures, which pickle by value: worker processes cannot import tests.
"""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from torchrl.envs import Compose, GymEnv, GymWrapper, StepCounter, TransformedEnv

from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.transforms import InterventionTransform


@pytest.fixture
def scripted_switch():
    """Builds a switch that follows a pattern over all steps, across resets; repeats it."""

    def build(pattern):
        class Scripted:
            memoryless = False

            def __init__(self):
                self.step = 0
                self.resets = 0

            def reset(self):
                self.resets += 1

            def __call__(self, situation):
                self.step += 1
                return bool(pattern[(self.step - 1) % len(pattern)])

        return Scripted

    return build


@pytest.fixture
def pendulum():
    """Builds a Pendulum whose mentor swings it up by its angular speed, read off the simulator."""

    def build(switch, horizon=None, mentor=None, before=(), after=(), **options):
        def make_mentor():
            return FunctionMentor(
                lambda simulator, step: [2.0 if simulator.state[1] >= 0 else -2.0]
            )

        transforms = [*before, InterventionTransform(mentor or make_mentor, switch, **options)]
        if horizon is not None:
            transforms.insert(0, StepCounter(max_steps=horizon))
        return TransformedEnv(GymEnv("Pendulum-v1"), Compose(*transforms, *after))

    return build


class Car(gymnasium.Env):
    """A car that gets the acceleration it asks for, -8 to 4 m/s²; followers keep their speed."""

    def __init__(self, speed: float = 12.0) -> None:
        box = gymnasium.spaces.Box
        self.action_space = box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = gymnasium.spaces.Dict(
            {
                "observation": box(-np.inf, np.inf, (1,), np.float32),
                "speed": box(0.0, 15.0, (1,), np.float32),
                "acceleration": box(-np.inf, np.inf, (1,), np.float32),
                "follower_gaps": box(-np.inf, np.inf, (2,), np.float32),
                "follower_speeds": box(0.0, 15.0, (2,), np.float32),
            }
        )
        self.initial_speed = speed

    def _state(self):
        return {
            "observation": np.array([self.speed], np.float32),
            "speed": np.array([self.speed], np.float32),
            "acceleration": np.array([self.acceleration], np.float32),
            "follower_gaps": np.array([15.0, 15.0], np.float32),
            "follower_speeds": np.array([self.initial_speed] * 2, np.float32),
        }

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.speed, self.acceleration = self.initial_speed, 0.0
        return self._state(), {}

    def step(self, action):
        pedal = float(action[0])
        wanted = 8.0 * pedal if pedal < 0 else 4.0 * pedal
        speed = min(15.0, max(0.0, self.speed + 0.1 * wanted))
        self.acceleration, self.speed = (speed - self.speed) / 0.1, speed
        return self._state(), 0.0, False, False, {}


@pytest.fixture
def car():
    """Builds the car with the given transforms."""

    def build(*transforms, speed=12.0):
        return TransformedEnv(GymWrapper(Car(speed)), Compose(*transforms))

    return build
