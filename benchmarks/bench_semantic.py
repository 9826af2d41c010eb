"""What images cost: drawing one, a step of the world, an update, and the replay's memory.

Run with ``python benchmarks/bench_semantic.py``. Images of 42 and 84 pixels stand beside the
numbers that are the default. The updates are the recipe's, with batches drawn beforehand. All are
timed in turn in one process on one thread, in CPU time, and the smallest of several rounds
counts.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from bench_env import Ours
from hydra import compose, initialize_config_dir
from tensordict import TensorDict

from haim_torchrl.data import make_replay_buffer
from haim_torchrl.envs import PlatoonEnv, make_env
from haim_torchrl.evaluation.assembly import Sizes, build, build_actor
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.terms import build_loss
from haim_torchrl.objectives import UpdateStep

CONF = Path(__file__).resolve().parent.parent / "conf"
SEES = ["env/observation=semantic", "actor=cnn", "critic=cnn"]
VIEWS: dict[str, list[str]] = {
    "numbers": [],
    "image of 42": SEES,
    "image of 84": [*SEES, "env.observation.size=84"],
}


def settings(overrides: list[str]) -> Any:
    """Settings of a run."""
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("haim", overrides)


def observation(overrides: list[str]) -> dict[str, Any]:
    """Settings of the observation."""
    return dict(settings(overrides).env.observation)


def drawing(env: PlatoonEnv) -> float:
    """CPU seconds of one image of a scene with traffic."""
    env.reset(seed=20_000)
    scene = env.snapshot()
    if env.eyes is None:
        return math.nan
    start = time.process_time()
    for _ in range(200):
        env.eyes.observe(scene)
    return (time.process_time() - start) / 200


def make_batch(shapes: dict[str, tuple[int, ...]], size: int) -> TensorDict:
    """Random transitions; the mentor drove half of them."""

    def look() -> dict[str, torch.Tensor]:
        return {
            key: torch.randint(256, (size, *shape), dtype=torch.uint8)
            if len(shape) == 3
            else torch.rand(size, *shape)
            for key, shape in shapes.items()
        }

    driven = torch.arange(size).unsqueeze(-1) % 2 == 0
    following = {
        **look(),
        "terminated": torch.rand(size, 1) < 0.02,
        "takeover_cost": torch.rand(size, 1),
        "disturbance_cost": torch.rand(size, 1),
    }
    data = {
        **look(),
        "action": torch.rand(size, 2) * 2.0 - 1.0,
        "action_agent": torch.rand(size, 2) * 2.0 - 1.0,
        "intervention": driven,
        "next": following,
    }
    return TensorDict(data, batch_size=[size])


def make_update(overrides: list[str], size: int) -> tuple[Callable[[], Any], float]:
    """An update with its batch, and the bytes that the replay keeps for a transition."""
    config = settings(overrides)
    env = make_env(observation=dict(config.env.observation))
    sizes = Sizes.of(env)
    actor = build_actor(config, sizes, torch.device("cpu"))
    loss = build_loss(config.loss, actor, partial(build, config.critic, sizes.observation, 2))
    step = UpdateStep(loss, build(config.optimizer, loss), loss.make_target_updater(0.005))
    shapes = sizes.observation
    batch = make_batch({"observation": (shapes,)} if isinstance(shapes, int) else shapes, size)
    replay = make_replay_buffer(size, size, keys=loss.in_keys)
    replay.extend(batch)
    return lambda: step(batch.copy()), replay.nbytes / size


def main() -> None:
    """Time everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=6)
    options = parser.parse_args()
    torch.set_num_threads(1)
    columns = "draw [ms]", "step [ms]", "reset [ms]", "update [ms]", "GB per 10 000"
    print(f"{'batch of ' + str(options.batch):14}" + "".join(f"{name:>15}" for name in columns))
    worlds = {k: Ours((20_000, 20_003), observation(v)) for k, v in VIEWS.items()}
    updates = {name: make_update(v, options.batch) for name, v in VIEWS.items()}
    best: dict[str, list[float]] = {name: [math.inf] * 4 for name in VIEWS}
    for _ in range(options.rounds):
        for name, ours in worlds.items():
            start = time.process_time()
            ours.env.reset(seed=20_003)
            reset = time.process_time() - start
            start = time.process_time()
            updates[name][0]()
            update = time.process_time() - start
            found = drawing(ours.env), ours.run(), reset, update
            best[name] = [min(pair) for pair in zip(best[name], found)]
    for name, figures in best.items():
        memory = updates[name][1] * 1e4 / 1e9
        row = [*(f"{value * 1e3:15.3f}" for value in figures), f"{memory:15.3f}"]
        print(f"{name:14}" + "".join(row))


if __name__ == "__main__":
    main()
