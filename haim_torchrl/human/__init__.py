"""A person in the loop: controls, console, watchdog and real time."""

from haim_torchrl.human.clock import Clock
from haim_torchrl.human.cockpit import Cockpit
from haim_torchrl.human.console import (
    Console,
    ConsoleError,
    Figures,
    Frame,
    PersonQuit,
    Scene,
)
from haim_torchrl.human.controls import RELEASED, Controls, Feel, Reading
from haim_torchrl.human.mentor import Brake, HumanMentor, Pause

__all__ = [
    "RELEASED",
    "Brake",
    "Clock",
    "Cockpit",
    "Console",
    "ConsoleError",
    "Controls",
    "Feel",
    "Figures",
    "Frame",
    "HumanMentor",
    "Pause",
    "PersonQuit",
    "Reading",
    "Scene",
]
