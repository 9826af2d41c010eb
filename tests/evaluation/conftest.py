"""A world small enough to work out by hand: a straight road, one car, one obstacle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.switches import Forecast

LENGTH, HALF_WIDTH, TIME_STEP, SPEED = 20.0, 2.0, 0.1, 10.0


class ToyRoad(EnvBase):
    """20 m of road at 10 m/s, so 20 steps; the second action component moves sideways.

    Even scenarios are free; odd ones have an obstacle at 10 m on the middle of the road. Leaving
    the road (more than 2 m aside) or hitting the obstacle (less than 0.5 m aside) ends the episode.
    """

    def __init__(self, horizon: int = 100) -> None:
        super().__init__(batch_size=[])
        self.horizon = horizon
        flags = ("success", "crash", "out_of_road", "wrong_way")
        self.observation_spec = Composite(
            observation=Unbounded(shape=(3,)),
            speed=Unbounded(shape=(1,)),
            acceleration=Unbounded(shape=(1,)),
            follower_gaps=Unbounded(shape=(2,)),
            follower_speeds=Unbounded(shape=(2,)),
            progress=Unbounded(shape=(1,)),
            cost=Unbounded(shape=(1,)),
            **{flag: Binary(1, shape=(1,), dtype=torch.bool) for flag in flags},
        )
        self.action_spec = Bounded(-1.0, 1.0, shape=(2,))
        self.reward_spec = Unbounded(shape=(1,))
        self.done_spec = Composite(
            {
                k: Binary(1, shape=(1,), dtype=torch.bool)
                for k in ("done", "terminated", "truncated")
            }
        )
        self.np_random = np.random.default_rng(0)
        self.scenario = 0
        self._begin(0)

    def _begin(self, scenario: int) -> None:
        self.scenario, self.x, self.y, self.steps, self.acceleration = scenario, 0.0, 0.0, 0, 0.0

    def _state(self, **events: float) -> dict[str, Tensor]:
        obstacle = 10.0 - self.x if self.scenario % 2 else 20.0
        state = {
            "observation": torch.tensor([self.x / LENGTH, self.y, obstacle / 20.0]),
            "speed": torch.tensor([SPEED]),
            "acceleration": torch.tensor([self.acceleration]),
            "follower_gaps": torch.full((2,), 10.0),
            "follower_speeds": torch.full((2,), SPEED),
            "progress": torch.tensor([self.x / LENGTH]),
            "cost": torch.tensor([float(events.get("crash", 0.0))]),
        }
        for flag in ("success", "crash", "out_of_road", "wrong_way"):
            state[flag] = torch.tensor([bool(events.get(flag, 0.0))])
        return state

    def _reset(
        self, tensordict: TensorDictBase | None, seed: int | None = None, **_: Any
    ) -> TensorDict:
        self._begin(int(self.np_random.integers(50)) if seed is None else seed)
        return TensorDict(self._state(), batch_size=[])

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        pedal, side = tensordict["action"].tolist()
        self.x += SPEED * TIME_STEP
        self.y += side
        self.steps += 1
        self.acceleration = 8.0 * pedal if pedal < 0 else 4.0 * pedal
        hit = bool(self.scenario % 2) and abs(self.x - 10.0) < 0.5 and abs(self.y) < 0.5
        off = abs(self.y) > HALF_WIDTH
        arrived = self.x >= LENGTH - 1e-9 and not hit and not off
        terminated = hit or off or arrived
        truncated = not terminated and self.steps >= self.horizon
        return TensorDict(
            {
                **self._state(crash=hit, out_of_road=off, success=arrived),
                "reward": torch.tensor([1.0 + 20.0 * arrived]),
                "done": torch.tensor([terminated or truncated]),
                "terminated": torch.tensor([terminated]),
                "truncated": torch.tensor([truncated]),
            },
            batch_size=[],
        )

    def _set_seed(self, seed: int | None) -> None:
        self.np_random = np.random.default_rng(seed)

    def forecast(self, action: np.ndarray) -> Forecast:
        return Forecast(departure=abs(self.y + float(action[1])) > HALF_WIDTH)

    def snapshot(self) -> Snapshot:
        behind = [[self.x - 15.0 * (k + 1), 0.0, 0.0, 5.0, 2.0] for k in range(2)]
        return Snapshot(
            time=self.steps * TIME_STEP,
            vehicle=np.array([self.x, self.y, 0.0, 5.0, 2.0]),
            speed=SPEED,
            acceleration=self.acceleration,
            followers=np.array(behind),
            follower_speeds=np.full(2, SPEED),
            follower_accelerations=np.zeros(2),
            follower_gaps=np.full(2, 10.0),
            obstacles=np.array([[10.0, 0.0, 0.0, 1.0, 1.0]] * (self.scenario % 2)).reshape(-1, 5),
            distance=self.x,
        )

    def road_polylines(self) -> list[RoadLine]:
        return [RoadLine(np.array([[0.0, y], [LENGTH, y]])) for y in (-HALF_WIDTH, HALF_WIDTH)]

    def scenario_labels(self) -> ScenarioLabels:
        return ScenarioLabels(self.scenario, ("straight",), self.scenario % 2)


class ToyMentor:
    """Goes round the obstacle at 1 m aside."""

    def reset(self, simulator: ToyRoad) -> None:
        pass

    def act(self, simulator: ToyRoad, tensordict: TensorDictBase) -> Tensor:
        return torch.tensor([0.0, min(max(1.0 - simulator.y, -1.0), 1.0)])


@pytest.fixture
def toy_road() -> type[ToyRoad]:
    return ToyRoad


@pytest.fixture
def toy_mentor() -> type[ToyMentor]:
    return ToyMentor
