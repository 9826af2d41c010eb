"""Steps per second of the collectors, in one process, in several, and in Ray.

Run with ``python benchmarks/bench_workers.py``; without the extra ``ray`` its column is left out.
All drive the default world with the shield and the expert, and are timed in turn, batch by batch,
so that whatever else the machine does slows all of them. It is wall-clock time: medians over the
batches, which on a busy machine say little of an idle one; their ratios say more.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import time
from contextlib import ExitStack

from torchrl.envs import Compose, EnvBase, TransformedEnv

from haim_torchrl.collectors import make_collector, make_ray_collector, shutting_down
from haim_torchrl.envs import make_env
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.modules import make_actor
from haim_torchrl.switches import Hold, RiskSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform


def world() -> EnvBase:
    """The world with an expert who takes over when harm is foreseen."""
    takeover = InterventionTransform(ExpertMentor, Hold(RiskSwitch(), 5))
    return TransformedEnv(make_env(), Compose(takeover, DisturbanceTransform()))


def main() -> None:
    """Time the collectors and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=100, help="steps of a batch")
    parser.add_argument("--batches", type=int, default=20, help="batches of each collector")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    env = world()
    actor = make_actor(env.observation_spec["observation"].shape[-1], 2)
    env.close()

    share = {"frames_per_batch": options.frames, "seed": 0}
    several = {**share, "num_workers": options.workers}
    names = {
        "sync": lambda: make_collector(world, actor, **share),
        f"parallel ({options.workers})": lambda: make_collector(world, actor, **several),
    }
    if importlib.util.find_spec("ray") is not None:
        names[f"ray ({options.workers})"] = lambda: make_ray_collector(world, actor, **several)

    with ExitStack() as stack:
        running, started, seconds, updates = {}, {}, {}, {}
        for name, make in names.items():
            begin = time.perf_counter()
            collector = make()
            stack.enter_context(shutting_down(collector))
            running[name] = (collector, iter(collector))
            next(running[name][1])  # workers compile and draw their first maps
            started[name] = time.perf_counter() - begin
            seconds[name], updates[name] = [], []
        for _ in range(options.batches):
            for name, (collector, batches) in running.items():
                begin = time.perf_counter()
                collector.update_policy_weights_()
                updates[name].append(time.perf_counter() - begin)
                next(batches)
                seconds[name].append(time.perf_counter() - begin)

    base = statistics.median(seconds["sync"])
    print(f"{os.cpu_count()} cores; batches of {options.frames} steps, {options.batches} of each")
    print(f"{'':14}{'steps/s':>9}{'of sync':>9}{'weights, ms':>13}{'start, s':>10}")
    for name, values in seconds.items():
        middle = statistics.median(values)
        weights = 1e3 * statistics.median(updates[name])
        print(
            f"{name:14}{options.frames / middle:9.0f}{base / middle:9.2f}"
            f"{weights:13.1f}{started[name]:10.1f}"
        )


if __name__ == "__main__":
    main()
