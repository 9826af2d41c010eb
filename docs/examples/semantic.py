"""A picture of the semantic observation: its five channels in one scene that the expert drives.

Writes ``semantic.png``. Options: ``--out docs/pictures --seed 7 --steps 278 --size 84``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from haim_torchrl.envs import PlatoonEnv
from haim_torchrl.envs.semantic import CHANNELS
from haim_torchrl.mentors.expert import ExpertMentor


def look(seed: int, steps: int, size: int) -> NDArray[np.uint8]:
    """What the agent sees after the expert has driven a scenario for a while, [5, size, size]."""
    env, expert = PlatoonEnv({"observation": {"view": "semantic", "size": size}}), ExpertMentor()
    seen, _ = env.reset(seed=seed)
    expert.reset(env)
    for _ in range(steps):
        seen, _, terminated, truncated, _ = env.step(expert.act(env).numpy())
        if terminated or truncated:
            raise SystemExit(f"scenario {seed} is over before step {steps}")
    return seen["pixels"]


def draw(image: NDArray[np.uint8], path: Path) -> None:
    """The channels side by side, white on black, and where the vehicle is."""
    figure, axes = plt.subplots(1, len(CHANNELS), figsize=(9, 2.1), dpi=100)
    size = image.shape[1]
    for axis, name, channel in zip(axes, CHANNELS, image):
        axis.imshow(channel, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axis.plot(size / 2 - 0.5, 2 * size / 3 - 0.5, marker="^", color="tab:red", markersize=4)
        axis.set_title(name, fontsize=9)
        axis.set_xticks([])
        axis.set_yticks([])
    figure.tight_layout(pad=0.5)
    figure.savefig(path)
    plt.close(figure)


def main() -> None:
    """Take the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "pictures")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--steps", type=int, default=278)
    parser.add_argument("--size", type=int, default=84)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "semantic.png"
    draw(look(options.seed, options.steps, options.size), path)
    print(path)


if __name__ == "__main__":
    main()
