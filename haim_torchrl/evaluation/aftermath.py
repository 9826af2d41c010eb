"""What a person hears and sees after they have taught: the coach, and the agent alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from omegaconf import DictConfig
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.modules import ProbabilisticActor

from haim_torchrl.coach import report_of
from haim_torchrl.data import TakeoverReplayBuffer
from haim_torchrl.data.session import SessionError
from haim_torchrl.evaluation.assembly import World, build
from haim_torchrl.evaluation.config import plain
from haim_torchrl.evaluation.drivers import Driver, PolicyDriver
from haim_torchrl.evaluation.evaluator import drive_episode
from haim_torchrl.evaluation.person import is_person
from haim_torchrl.human import Cockpit, Console, PersonQuit
from haim_torchrl.human.takeovers import TakeoverError

WAIT_FOR_VIEWER = 15.0
"""Seconds in which a page finds its way back to a console that has moved to another process."""


def say_how_it_was(
    config: DictConfig, folder: Path, replay: TakeoverReplayBuffer, actor: ProbabilisticActor
) -> None:
    """Print what the coach has to say after the run, to a person.

    Args:
        config: Settings of the run.
        folder: Its folder.
        replay: Its transitions; the mentor-driven ones show whether they changed the policy.
        actor: The trained policy.
    """
    if not is_person(config) or not config.record:
        return
    kept, driver = replay.intervened.columns(), PolicyDriver(actor)
    known: dict[str, Any] = {}
    # What was executed in these steps is what the mentor did.
    names = {"action_mentor": "action"} | {
        key: key for key in ("observation", "action_agent", "intervention")
    }
    if all(key in kept for key in names.values()):
        rows = {name: kept[key] for name, key in names.items()}
        known["transitions"] = TensorDict(rows, [len(replay.intervened)]).cpu()
        known["policy"] = lambda seen: driver.act(None, TensorDict({"observation": seen}))
    try:
        report = report_of(folder, **known)
    except (SessionError, TakeoverError) as error:
        print(f"the coach has nothing to say: {error}")
        return
    (folder / "coach.txt").write_text(f"{report}\n")
    print(f"\n{report}")


def show_alone(config: DictConfig, driver: Driver) -> None:
    """Let the person watch the trained agent drive alone, ``eval.show`` scenarios in real time.

    Args:
        config: Settings of the run.
        driver: The trained policy.
    """
    if not is_person(config) or config.eval.show < 1:
        return
    console = build(plain(config.mentor)["console"])
    if not _somebody_watches(console):
        console.close()
        return
    world = World.of(config, "train", takeovers=False)
    env = world()
    assert isinstance(env, TransformedEnv)
    env.append_transform(Cockpit(config.collector.pace, console=console))
    print(f"the agent drives alone now, {config.eval.show} times; watch, or quit to go on")
    try:
        for scenario in world.seeds()[: config.eval.show]:
            drive_episode(env, driver, scenario)
    except (PersonQuit, KeyboardInterrupt):
        print("watched enough")
    finally:
        env.close()


def _somebody_watches(console: Console) -> bool:
    """Open the console, and wait a while until the person is there again."""
    console.open()
    until = time.monotonic() + WAIT_FOR_VIEWER
    while time.monotonic() < until:
        if console.read().connected:
            return True
        time.sleep(0.1)
    return False
