"""What one disturbance cost costs, against the same prediction as a plain Python loop.

Run with ``python benchmarks/bench_disturbance.py``. All variants are timed in turn in one process
and the smallest of several rounds counts, so the printed ratios hold on a busy machine too.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence

import numpy as np
import torch

from haim_torchrl.traffic import IDMParameters, disturbance_cost
from haim_torchrl.traffic.kernels import idm_constants, idm_mean_speed

STEPS, TIME_STEP, MAX_SPEED = 100, 0.1, 15.0
GOAL = 50.0


def python_mean_speed(
    gaps: Sequence[float], speeds: Sequence[float], lead_speed: float, lead_acceleration: float
) -> float:
    """The prediction as one would first write it: one vehicle after another, in floats."""
    p = IDMParameters()
    gaps, vehicles = list(gaps), [lead_speed, *speeds]
    root = 2.0 * math.sqrt(p.max_acceleration * p.comfortable_deceleration)
    total = sum(speeds)
    for _ in range(STEPS):
        ways, new_speeds = [], []
        for i, speed in enumerate(vehicles):
            if i == 0:
                acceleration = lead_acceleration
            else:
                approach = speed * (speed - vehicles[i - 1]) / root
                desired_gap = p.s0 + max(0.0, speed * p.time_headway + approach)
                acceleration = p.max_acceleration * (
                    1.0
                    - (speed / p.desired_speed) ** p.exponent
                    - (desired_gap / max(gaps[i - 1], 0.1)) ** 2
                )
            unlimited = speed + acceleration * TIME_STEP
            if unlimited < 0.0:
                new_speeds.append(0.0)
                ways.append(speed * speed / (-2.0 * acceleration))
            else:
                new_speeds.append(min(unlimited, MAX_SPEED))
                ways.append(0.5 * TIME_STEP * (speed + new_speeds[-1]))
        gaps = [gap + ways[i] - ways[i + 1] for i, gap in enumerate(gaps)]
        vehicles = new_speeds
        total += sum(vehicles[1:])
    return total / (len(gaps) * (STEPS + 1))


def python_cost(
    gaps: Sequence[float], speeds: Sequence[float], lead_speed: float, lead_acceleration: float
) -> float:
    """Both predictions of the counterfactual cost (eq. 20), in floats."""
    free = python_mean_speed(gaps, speeds, lead_speed, 0.0)
    braked = python_mean_speed(gaps, speeds, lead_speed, lead_acceleration)
    return 1.0 - math.exp(-max(0.0, free - braked))


def fastest(variants: dict[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """Seconds of one call of each variant: the best round of ``rounds`` interleaved ones."""
    best = dict.fromkeys(variants, math.inf)
    for _ in range(rounds):
        for name, (call, repeats) in variants.items():
            start = time.perf_counter()
            for _ in range(repeats):
                call()
            best[name] = min(best[name], (time.perf_counter() - start) / repeats)
    return best


def main() -> None:
    """Time the variants and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=1024, help="size of the batch")
    parser.add_argument("--followers", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    torch.set_num_threads(1)

    generator = torch.Generator().manual_seed(0)
    size = (options.states, options.followers)
    gaps = 5.0 + 25.0 * torch.rand(*size, generator=generator)
    speeds = 15.0 * torch.rand(*size, generator=generator)
    lead_speed = 15.0 * torch.rand(size[0], 1, generator=generator)
    pulse = -8.0 * torch.rand(size[0], 1, generator=generator)

    first = [part[0] for part in (gaps, speeds, lead_speed, pulse)]
    numbers = first[0].tolist(), first[1].tolist(), first[2].item(), first[3].item()
    gradient = pulse.clone().requires_grad_()
    arrays = first[0][None].numpy(), first[1][None].numpy(), first[2].numpy()
    pulses = np.array([[numbers[3]], [0.0]], dtype=np.float32)
    kernel_settings = STEPS, STEPS, TIME_STEP, MAX_SPEED, idm_constants(IDMParameters())

    difference = abs(python_cost(*numbers) - disturbance_cost(*first).item())
    if difference > 1e-4:
        raise SystemExit(f"the Python loop and the library differ by {difference:.2e}")

    seconds = fastest(
        {
            "Python loop, one state": (lambda: python_cost(*numbers), 2),
            "compiled loop alone, one state": (
                lambda: idm_mean_speed(*arrays, pulses, *kernel_settings),
                100,
            ),
            "disturbance_cost, one state": (lambda: disturbance_cost(*first), 100),
            f"disturbance_cost, {size[0]} states": (
                lambda: disturbance_cost(gaps, speeds, lead_speed, pulse),
                1,
            ),
            f"with gradient, {size[0]} states": (
                lambda: disturbance_cost(gaps, speeds, lead_speed, gradient),
                1,
            ),
        },
        options.rounds,
    )
    base = seconds["Python loop, one state"]
    print(f"{size[1]} followers, {STEPS} steps of {TIME_STEP} s, two predictions per cost")
    print(f"{'':34}{'us per state':>14}{'ratio':>10}")
    for name, value in seconds.items():
        per_state = value / (size[0] if name.endswith("states") else 1)
        print(f"{name:34}{per_state * 1e6:14.1f}{base / per_state:10.1f}")
    ratio = base * size[0] / seconds[f"disturbance_cost, {size[0]} states"]
    verdict = "met" if ratio >= GOAL else "MISSED"
    print(
        f"goal: {size[0]} states at least {GOAL:.0f} times cheaper than the Python loop: {verdict}"
    )
    if ratio < GOAL:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
