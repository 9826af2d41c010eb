"""A window to drive in, with keys, a pad or a wheel."""

from haim_torchrl.human.window.axes import Mapping, Pedal, PedalButton, Steering
from haim_torchrl.human.window.calibration import load_calibration, save_calibration
from haim_torchrl.human.window.console import WindowConsole
from haim_torchrl.human.window.draw import Painter

__all__ = [
    "Mapping",
    "Painter",
    "Pedal",
    "PedalButton",
    "Steering",
    "WindowConsole",
    "load_calibration",
    "save_calibration",
]
