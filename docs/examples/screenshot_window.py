"""Draw the window as a person sees it, without a screen: docs/pictures/window.png.

The expert plays the agent. In the middle of the drive somebody takes over, by keys pressed here.
Options: ``--scenario 2 --steps 60 --out window.png``.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

import pygame
import torch
from torchrl.envs import TransformedEnv

from haim_torchrl.envs import make_env
from haim_torchrl.human import Cockpit, HumanMentor
from haim_torchrl.human.window import WindowConsole
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import RequestSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform

PICTURE = Path(__file__).parents[1] / "pictures" / "window.png"


def press(key, place):
    """Press a key of the console's window, and keep it pressed."""
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key, scancode=place))


def main(arguments=None):
    """Drive, take over, and keep the last picture. Returns where it is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", type=int, default=2, help="number of the scenario")
    parser.add_argument("--steps", type=int, default=60, help="steps to drive")
    parser.add_argument("--takeover", type=int, default=5, help="of them the person's, at the end")
    parser.add_argument("--out", type=Path, default=PICTURE, help="picture to write")
    options = parser.parse_args(arguments)

    console = WindowConsole()
    takeover = InterventionTransform(lambda: HumanMentor(console), RequestSwitch())
    env = TransformedEnv(make_env(), takeover)
    env.append_transform(DisturbanceTransform())
    env.append_transform(Cockpit(total_steps=20_000))
    env.set_seed(options.scenario)
    state, agent = env.reset(), ExpertMentor()
    simulator = takeover.simulator(env.base_env)
    agent.reset(simulator)
    for step in range(options.steps):
        if step == options.steps - options.takeover:
            press(pygame.K_UP, pygame.KSCAN_UP)
            press(pygame.K_LEFT, pygame.KSCAN_LEFT)
        state["action"] = agent.act(simulator, state)
        state = env.step(state)["next"]
        if state["done"]:
            break
    options.out.parent.mkdir(parents=True, exist_ok=True)
    pygame.image.save(pygame.display.get_surface(), options.out)
    env.close()
    return options.out


if __name__ == "__main__":
    torch.set_num_threads(1)
    print(main())
