"""What a run needs when its mentor is a person at a console."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig
from torchrl.envs import TransformedEnv

from haim_torchrl.evaluation.assembly import World, build
from haim_torchrl.evaluation.config import ConfigError, plain
from haim_torchrl.evaluation.drivers import Driver
from haim_torchrl.evaluation.evaluator import drive_episode
from haim_torchrl.human import Cockpit, ConsoleError, PersonQuit
from haim_torchrl.human.availability import check_console


def is_person(config: Any) -> bool:
    """Whether the mentor is a person."""
    return str(config.mentor.get("_target_", "")).endswith(".HumanMentor")


def check_person(config: DictConfig) -> None:
    """Refuse what a person cannot do, and a console that cannot open here.

    Raises:
        ConfigError: With one sentence that names the key and the fix.
    """
    if not is_person(config):
        return
    if "train" not in config:
        raise ConfigError(
            "mentor is a person, who takes part in recipes/haim.py only; choose another mentor "
            "here, such as mentor=expert"
        )
    if config.collector.get("num_workers", 0):
        raise ConfigError(
            "mentor is a person, who drives one vehicle; use collector=live, or collector=sync"
        )
    if config.collector.get("pace") is None:
        raise ConfigError(
            "mentor is a person, who needs time to see; set collector.pace, in steps per second, "
            "or use collector=live"
        )
    if "RequestSwitch" not in str(plain(config.switch)):
        raise ConfigError(
            "mentor is a person, who takes over when they want to; use switch=request, or a "
            "switch that contains it"
        )
    try:
        check_console(plain(config.mentor))
    except ConsoleError as error:
        raise ConfigError(str(error)) from error


def show_alone(config: DictConfig, driver: Driver) -> None:
    """Let the person watch the trained agent drive alone, ``eval.show`` scenarios in real time.

    Args:
        config: Settings of the run.
        driver: The trained policy.
    """
    if not is_person(config) or config.eval.show < 1:
        return
    world = World.of(config, "train", takeovers=False)
    env = world()
    assert isinstance(env, TransformedEnv)
    console = build(plain(config.mentor)["console"])
    env.append_transform(Cockpit(config.collector.pace, console=console))
    print(f"the agent drives alone now, {config.eval.show} times; watch, or quit to go on")
    try:
        for scenario in world.seeds()[: config.eval.show]:
            drive_episode(env, driver, scenario)
    except (PersonQuit, KeyboardInterrupt):
        print("watched enough")
    finally:
        env.close()
