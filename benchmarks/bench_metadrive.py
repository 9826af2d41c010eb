"""MetaDrive behind the adapter against MetaDrive alone, and memory over many episodes.

python benchmarks/bench_metadrive.py                  # speed: a few minutes
python benchmarks/bench_metadrive.py --episodes 200   # memory, too

Two processes, since each may hold one engine, take turns at driving the same scenarios with the
same actions: MetaDrive as it is, with the same settings and no followers, and the adapter with its
five. What counts is the time that a process computes, which others on the machine hardly change,
and the ratio of a pair of turns.
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

STEPS = 300
"""Steps of one turn."""


def actions(steps: int) -> np.ndarray:
    """What is driven: mostly straight on, gently."""
    rng = np.random.default_rng(0)
    return np.stack([rng.uniform(0.0, 0.6, steps), rng.normal(0.0, 0.03, steps)], 1)


def bare(connection: Connection) -> None:
    """MetaDrive alone."""
    from haim_torchrl.envs.metadrive.config import MetaDriveConfig
    from haim_torchrl.envs.metadrive.engine import PlatoonMetaDrive, translate

    class Alone(PlatoonMetaDrive):
        """Without followers."""

        def setup_engine(self) -> None:
            super(PlatoonMetaDrive, self).setup_engine()

    settings = MetaDriveConfig.of({"scenarios": 200, "observation": {"view": "rays"}})
    env = Alone(settings)
    env.lazy_init()
    assert env.config["traffic_density"] == translate(settings)["traffic_density"]

    def reset(seed: int) -> None:
        env.reset(seed=seed)
        env.agent.config["max_speed_km_h"] = 40.0

    def step(action: np.ndarray) -> bool:
        *_, terminated, truncated, _ = env.step([-action[1], action[0]])
        return terminated or truncated

    serve(connection, reset, step)


def adapted(connection: Connection, view: str) -> None:
    """The adapter, with followers, through its Gymnasium interface."""
    from haim_torchrl.envs.metadrive.config import MetaDriveConfig
    from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator

    settings = MetaDriveConfig.of({"scenarios": 200, "observation": {"view": view}})
    env = MetaDriveSimulator(settings)

    def step(action: np.ndarray) -> bool:
        *_, terminated, truncated, _ = env.step(action)
        return terminated or truncated

    serve(connection, lambda seed: env.reset(seed=seed), step)


def serve(connection: Connection, reset: Any, step: Any) -> None:
    """Drive a turn for each seed received, and send the CPU time that it took [s]; None ends it."""
    moves = actions(STEPS)
    while (seed := connection.recv()) is not None:
        reset(seed)
        begin, resets = time.process_time(), 0.0
        for move in moves:
            if step(move):
                before = time.process_time()
                reset(seed)
                resets += time.process_time() - before
        connection.send(time.process_time() - begin - resets)


def start(target: Any, *args: Any) -> Connection:
    """A process that takes turns."""
    here, there = multiprocessing.get_context("spawn").Pipe()
    multiprocessing.get_context("spawn").Process(
        target=target, args=(there, *args), daemon=True
    ).start()
    return here


def turn(connection: Connection, seed: int) -> float:
    """One turn [s]."""
    connection.send(seed)
    return connection.recv()


def memory(episodes: int) -> None:
    """Resident memory of one process over its episodes."""
    import psutil

    from haim_torchrl.envs.metadrive.config import MetaDriveConfig
    from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator

    env, process = MetaDriveSimulator(MetaDriveConfig(scenarios=50)), psutil.Process()
    figures = []
    for episode in range(episodes):
        env.reset(seed=episode % 50)
        for move in actions(20):
            env.step(move)
        figures.append(process.memory_info().rss / 2**20)
        if episode + 1 in (1, 25, 50, 75, 100, 125, 150, 175, 200) or episode + 1 == episodes:
            print(f"  after {episode + 1:4d} episodes: {figures[-1]:7.0f} MiB", flush=True)
    env.close()


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=0)
    options = parser.parse_args()
    contestants = {
        "MetaDrive alone": start(bare),
        "adapter, rays": start(adapted, "rays"),
        "adapter, route view": start(adapted, "route"),
    }
    for connection in contestants.values():
        turn(connection, 0)  # compiles, and warms up
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for k in range(options.turns):
        for name, connection in contestants.items():
            times[name].append(turn(connection, 1 + k))
    base = times["MetaDrive alone"]
    for name, values in times.items():
        ratio = statistics.median(b / v for b, v in zip(base, values))
        print(f"{name:22s} {STEPS / statistics.median(values):6.1f} steps/s  {ratio:5.2f}x")
    for connection in contestants.values():
        connection.send(None)
    if options.episodes:
        print("memory over episodes of 20 steps on 50 maps:")
        memory(options.episodes)


if __name__ == "__main__":
    main()
