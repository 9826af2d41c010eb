"""How fast the X+1+N world steps, against stock highway-env scenes, and what disturbance adds.

Run with ``python benchmarks/bench_env.py``. All scenes are stepped in turn in one process, in CPU
time and without resets, and the smallest of several rounds counts, so the printed ratios hold on a
busy machine too. The stock scenes have as many vehicles as ours on average, 240 rays, steering and
acceleration as actions, and one simulation step of 0.1 s per action, as ours.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers its scenes)
import numpy as np
import torch

from haim_torchrl.envs import PlatoonEnv
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.traffic import disturbance_cost, hard_brake_onset

GOAL, DISTURBANCE_GOAL = 3.0, 0.02
SCENES = "highway-v0", "exit-v1"


class Ours:
    """The world, driven by actions that the expert chose beforehand.

    Args:
        seeds: scenarios that are driven.
        observation: settings of the observation.
        scenario: settings of the scenarios.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        observation: Mapping[str, Any] | None = None,
        **scenario: Any,
    ) -> None:
        self.env = PlatoonEnv({"scenario": scenario, "observation": dict(observation or {})})
        expert, bodies = ExpertMentor(), []
        self.actions = []
        for seed in seeds:
            self.env.reset(seed=seed)
            expert.reset(self.env)
            ended = False
            self.actions.append((seed, []))
            while not ended:
                self.actions[-1][1].append(expert.act(self.env).numpy())
                *_, terminated, truncated, _ = self.env.step(self.actions[-1][1][-1])
                bodies.append(len(self.env.road.bodies))
                ended = terminated or truncated
        self.vehicles = round(float(np.mean(bodies)))

    def run(self) -> float:
        """CPU seconds of one step."""
        spent, steps = 0.0, 0
        for seed, actions in self.actions:
            self.env.reset(seed=seed)
            start = time.process_time()
            for action in actions:
                self.env.step(action)
            spent += time.process_time() - start
            steps += len(actions)
        return spent / steps


class Stock:
    """A scene of highway-env, whose ego vehicle drives straight on at a constant speed.

    Args:
        name: the scene.
        vehicles: number of vehicles, the ego vehicle included.
        steps: steps of one round.
    """

    def __init__(self, name: str, vehicles: int, steps: int) -> None:
        config = {
            "action": {"type": "ContinuousAction"},
            "observation": {"type": "LidarObservation", "cells": 240, "maximum_range": 50.0},
            "vehicles_count": vehicles - 1,
            "policy_frequency": 10,
            "simulation_frequency": 10,
        }
        self.env = gym.make(name, config=config).unwrapped
        self.env.reset(seed=0)
        self.steps = steps
        if len(self.env.road.vehicles) != vehicles:
            raise SystemExit(f"{name} has {len(self.env.road.vehicles)} vehicles, not {vehicles}")

    def run(self) -> float:
        """CPU seconds of one step."""
        spent, action, ended = 0.0, np.zeros(2), True
        for step in range(self.steps):
            if ended or step % 100 == 0:
                self.env.reset(seed=step)
            start = time.process_time()
            *_, terminated, truncated, _ = self.env.step(action)
            spent += time.process_time() - start
            ended = terminated or truncated
        return spent / self.steps


def onset_rate(choose: Callable[[PlatoonEnv], np.ndarray], steps: int) -> float:
    """Share of steps in which a hard brake sets in, which is when the predictor runs."""
    env, onsets, before = PlatoonEnv(), 0, 0.0
    env.reset(seed=0)
    for _ in range(steps):
        *_, terminated, truncated, info = env.step(choose(env))
        now = torch.tensor(info["acceleration"])
        onsets += bool(hard_brake_onset(now, torch.tensor(before)))
        before = info["acceleration"]
        if terminated or truncated:
            env.reset()
            before = 0.0
    return onsets / steps


def prediction_time(followers: int) -> float:
    """CPU seconds of one disturbance cost."""
    state = torch.full((followers,), 12.0), torch.full((followers,), 9.0), torch.tensor([9.0])
    pulse, best = torch.tensor([-7.0]), math.inf
    for _ in range(20):
        start = time.process_time()
        for _ in range(50):
            disturbance_cost(*state, pulse)
        best = min(best, (time.process_time() - start) / 50)
    return best


def expert_driver() -> Callable[[PlatoonEnv], np.ndarray]:
    """The expert, made ready at the start of each episode."""
    expert = ExpertMentor()

    def choose(env: PlatoonEnv) -> np.ndarray:
        if env.steps == 0:
            expert.reset(env)
        return expert.act(env).numpy()

    return choose


def main() -> None:
    """Time the scenes and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=150, help="steps of a stock scene per round")
    parser.add_argument("--rounds", type=int, default=4)
    options = parser.parse_args()
    torch.set_num_threads(1)

    ratios, ours_seconds = [], math.inf
    print(f"{'scene':24}{'vehicles':>9}{'us per step':>13}{'steps/s':>9}{'ratio':>7}")
    dense = {"traffic_density": 4.0, "lanes": (3,)}
    for label, scenario in (("ours", {}), ("ours, 3 lanes and dense", dense)):
        ours = Ours((20_000, 20_003), **scenario)
        scenes = {label: ours} | {
            name: Stock(name, ours.vehicles, options.steps) for name in SCENES
        }
        best = dict.fromkeys(scenes, math.inf)
        for _ in range(options.rounds):
            for name, scene in scenes.items():
                best[name] = min(best[name], scene.run())
        for name, seconds in best.items():
            ratio = seconds / best[label]
            print(f"{name:24}{ours.vehicles:9}{seconds * 1e6:13.0f}{1 / seconds:9.0f}{ratio:7.2f}")
        ratios.append(min(best[name] for name in SCENES) / best[label])
        ours_seconds = min(ours_seconds, best[label])
    met = min(ratios) >= GOAL
    print(f"goal: at least {GOAL:.0f} times as fast: {'met' if met else 'MISSED'}")

    rng = np.random.default_rng(0)
    drivers = {
        "uniformly random": lambda env: rng.uniform(-1.0, 1.0, 2),
        "expert": expert_driver(),
    }
    call, shares = prediction_time(5), []
    print(f"\none prediction takes {call * 1e6:.0f} us; it runs when a hard brake sets in")
    print(f"{'driver':24}{'onsets per step':>16}{'share of a step':>17}")
    for name, choose in drivers.items():
        rate = onset_rate(choose, 1500)
        shares.append(rate * call / ours_seconds)
        print(f"{name:24}{rate:16.4f}{shares[-1]:17.2%}")
    cheap = max(shares) <= DISTURBANCE_GOAL
    print(f"goal: at most {DISTURBANCE_GOAL:.0%} of a step: {'met' if cheap else 'MISSED'}")
    if not (met and cheap):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
