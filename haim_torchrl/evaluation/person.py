"""What a run needs when its mentor is a person at a console."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig

from haim_torchrl.evaluation.config import ConfigError, names_mentor, plain
from haim_torchrl.human.availability import check_console
from haim_torchrl.human.console import ConsoleError


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
    if "train" not in config:  # a policy that a person taught is evaluated without that person
        if not names_mentor(config):
            return
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
