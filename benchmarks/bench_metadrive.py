"""MetaDrive behind the adapter against MetaDrive alone, and memory over many episodes.

python benchmarks/bench_metadrive.py                  # speed: a few minutes
python benchmarks/bench_metadrive.py --episodes 200   # memory, too

Three processes, since each may hold one engine, drive the same scenarios as the expert once did:
MetaDrive as it is, with the same settings and no followers, and the adapter with its five, in both
views. They take turns of ten steps, and stop together once the scenario is over for one of them.
What counts is the time that a process computes, which others on the machine hardly change.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

SCENARIOS = 200
"""How many the engines may load."""
STEPS = 300
"""Most steps of a scenario."""
TURN = 10
"""Steps until the next takes its turn."""


def bare(connection: Connection) -> None:
    """MetaDrive alone, driven by its own commands."""
    from haim_torchrl.envs.metadrive.config import MetaDriveConfig
    from haim_torchrl.envs.metadrive.engine import PlatoonMetaDrive

    class Alone(PlatoonMetaDrive):
        """Without followers."""

        def setup_engine(self) -> None:
            super(PlatoonMetaDrive, self).setup_engine()

    settings = {"scenarios": SCENARIOS, "observation": {"view": "rays"}}
    env = Alone(MetaDriveConfig.of(settings))
    env.lazy_init()

    def reset(seed: int) -> None:
        env.reset(seed=seed)
        env.agent.config["max_speed_km_h"] = 40.0

    serve(connection, reset, lambda _, command: env.step(command))


def adapted(connection: Connection, view: str) -> None:
    """The adapter, with followers, through its Gymnasium interface."""
    from haim_torchrl.envs.metadrive.config import MetaDriveConfig
    from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator

    settings = MetaDriveConfig.of({"scenarios": SCENARIOS, "observation": {"view": view}})
    env = MetaDriveSimulator(settings)
    serve(connection, lambda seed: env.reset(seed=seed), lambda action, _: env.step(action))


def expert(connection: Connection) -> None:
    """Drives each scenario received, and sends what it did: actions, and MetaDrive's commands."""
    from haim_torchrl.envs.metadrive.car import car_model, to_metadrive
    from haim_torchrl.envs.metadrive.config import MetaDriveConfig
    from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator
    from haim_torchrl.mentors.expert import ExpertMentor

    settings = MetaDriveConfig(scenarios=SCENARIOS)
    env, mentor = MetaDriveSimulator(settings), ExpertMentor()
    while (seed := connection.recv()) is not None:
        env.reset(seed=seed)
        mentor.reset(env)
        moves, done = [], False
        while not done and len(moves) < STEPS:
            action = mentor.act(env).numpy()
            command = car_model(env.agent, settings).command(*map(float, action))
            moves.append((action, to_metadrive(env.agent, *command)))
            _, _, terminated, truncated, _ = env.step(action)
            done = terminated or truncated
        connection.send(moves)


def serve(connection: Connection, reset: Callable, step: Callable) -> None:
    """Resets to a seed or drives the moves received; sends the CPU time [s] and whether it ended.

    None ends it.
    """
    while (order := connection.recv()) is not None:
        begin, done = time.process_time(), False
        if isinstance(order, int):
            reset(order)
        else:
            for action, command in order:
                _, _, terminated, truncated, _ = step(action, command)
                done = done or terminated or truncated
        connection.send((time.process_time() - begin, done))


def start(target: Callable, *args: Any) -> Connection:
    """A process that takes orders."""
    here, there = multiprocessing.get_context("spawn").Pipe()
    multiprocessing.get_context("spawn").Process(
        target=target, args=(there, *args), daemon=True
    ).start()
    return here


def ask(connection: Connection, order: Any) -> Any:
    """The answer to an order."""
    connection.send(order)
    return connection.recv()


def race(contestants: list[Connection], seed: int, moves: list) -> tuple[np.ndarray, int]:
    """CPU time of each contestant [s] over the steps of one scenario, and their number."""
    for contestant in contestants:
        ask(contestant, seed)
    times, steps = np.zeros(len(contestants)), 0
    for turn in range(0, len(moves) - TURN + 1, TURN):
        answers = [ask(contestant, moves[turn : turn + TURN]) for contestant in contestants]
        if any(done for _, done in answers):
            break
        times += [seconds for seconds, _ in answers]
        steps += TURN
    return times, steps


def speed(scenarios: int) -> None:
    """Print steps per second of CPU time, and how much of MetaDrive's own that is."""
    contestants = {
        "MetaDrive alone": start(bare),
        "adapter, rays": start(adapted, "rays"),
        "adapter, route view": start(adapted, "route"),
    }
    connections, driver = list(contestants.values()), start(expert)
    race(connections, 0, ask(driver, 0))  # compiles, and warms up
    races = [race(connections, 1 + k, ask(driver, 1 + k)) for k in range(scenarios)]
    times = np.array([seconds for seconds, _ in races])
    steps = sum(count for _, count in races)
    ratios = times[:, :1] / times
    print(f"{scenarios} scenarios, {steps} steps; quartiles over scenarios in brackets")
    for k, name in enumerate(contestants):
        low, high = np.quantile(ratios[:, k], (0.25, 0.75))
        total = times[:, k].sum()
        print(
            f"{name:22s} {steps / total:6.1f} steps/s  "
            f"{times[:, 0].sum() / total:5.2f}x [{low:.2f}, {high:.2f}]"
        )
    for connection in (*connections, driver):
        connection.send(None)


def memory(episodes: int) -> None:
    """Resident memory of one process over its episodes."""
    import psutil

    from haim_torchrl.envs.metadrive.config import MetaDriveConfig
    from haim_torchrl.envs.metadrive.simulator import MetaDriveSimulator

    env, process = MetaDriveSimulator(MetaDriveConfig(scenarios=50)), psutil.Process()
    rng, figures = np.random.default_rng(0), []
    for episode in range(episodes):
        env.reset(seed=episode % 50)
        for _ in range(20):
            env.step(np.array([rng.uniform(0.0, 0.6), rng.normal(0.0, 0.03)]))
        figures.append(process.memory_info().rss / 2**20)
        if episode + 1 in (1, 25, 50, 75, 100, 125, 150, 175, 200) or episode + 1 == episodes:
            print(f"  after {episode + 1:4d} episodes: {figures[-1]:7.0f} MiB", flush=True)
    env.close()


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenarios", type=int, default=16)
    parser.add_argument("--episodes", type=int, default=0)
    options = parser.parse_args()
    speed(options.scenarios)
    if options.episodes:
        print("memory over episodes of 20 steps on 50 maps:")
        memory(options.episodes)


if __name__ == "__main__":
    main()
