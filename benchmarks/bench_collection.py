"""What collecting transitions adds to the simulation, part by part.

Run with ``python benchmarks/bench_collection.py``. Every variant drives the same episodes with the
same executed actions. All are timed in turn in one process, in CPU time, and the smallest of
several rounds counts, so the printed ratios hold on a busy machine too.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import Compose, EnvBase, TransformedEnv

from haim_torchrl.collectors import as_acting_policy, make_collector
from haim_torchrl.envs import make_env, make_gym_env
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.modules import make_actor
from haim_torchrl.switches import Hold, Never, RiskSwitch, Switch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform


class Plain(TensorDictModuleBase):
    """Hides what kind of actor this is, so that it is run in its general form."""

    def __init__(self, actor: TensorDictModuleBase) -> None:
        super().__init__()
        self.actor, self.in_keys, self.out_keys = actor, actor.in_keys, actor.out_keys

    def forward(self, tensordict):
        """Whatever the actor writes."""
        return self.actor(tensordict)


def world(switch: Switch) -> EnvBase:
    """The world with an expert who takes over when the switch says so."""
    takeover = InterventionTransform(ExpertMentor, switch)
    return TransformedEnv(make_env(), Compose(takeover, DisturbanceTransform()))


def collect(
    switch: Switch, policy: TensorDictModuleBase, steps: int
) -> Callable[[], tuple[float, np.ndarray]]:
    """A function that collects from scenario set and policy seed 0: seconds, executed actions."""

    def run() -> tuple[float, np.ndarray]:
        torch.manual_seed(0)
        collector = make_collector(
            lambda: world(switch), policy, frames_per_batch=steps, total_frames=steps, seed=0
        )
        start = time.process_time()
        (batch,) = collector
        return time.process_time() - start, batch["action"].numpy()

    return run


def simulate(actions: np.ndarray) -> float:
    """Seconds that the bare simulator needs for the same steps."""
    env = make_gym_env().unwrapped
    env.reset(seed=int(np.random.SeedSequence(0).spawn(1)[0].generate_state(1)[0]))
    env.reset()
    start = time.process_time()
    for action in actions:
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return time.process_time() - start


def act(policy: TensorDictModuleBase, steps: int) -> float:
    """Seconds that the policy alone needs for as many observations."""
    observation = make_env().reset().select("observation")
    start = time.process_time()
    with torch.no_grad():
        for _ in range(steps):
            policy(observation)
    return time.process_time() - start


def main() -> None:
    """Time the variants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400, help="steps of one round")
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    size = make_env().observation_spec["observation"].shape[-1]
    actor = make_actor(size, 2)
    lean, shield = as_acting_policy(actor), Hold(RiskSwitch(), 5)
    collected = {
        "collector, general form of the actor": collect(Never(), Plain(actor), options.steps),
        "collector": collect(Never(), lean, options.steps),
        "collector, mentor takes over at risk": collect(shield, lean, options.steps),
    }
    best: dict[str, float] = {}

    def note(name: str, seconds: float) -> None:
        best[name] = min(best.get(name, math.inf), seconds / options.steps)

    for _ in range(options.rounds):
        for name, run in collected.items():
            seconds, actions = run()
            note(name, seconds)
        note("simulator alone", simulate(actions))
        note("actor alone, general form", act(actor, options.steps))
        note("actor alone", act(lean, options.steps))
    base = best["simulator alone"]
    print(f"{options.steps} steps; observation of {size} numbers; hidden layers 256, 256")
    print(f"{'':40}{'us per step':>12}{'simulations':>13}")
    for name, value in sorted(best.items(), key=lambda item: item[1]):
        print(f"{name:40}{value * 1e6:12.0f}{value / base:13.2f}")


if __name__ == "__main__":
    main()
