"""Pads and wheels as devices: found, opened, lost and found again."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Literal

import pygame
from pygame._sdl2 import controller

from haim_torchrl.human.console import ConsoleError
from haim_torchrl.human.controls import RELEASED, Controls
from haim_torchrl.human.window.axes import Mapping, facing
from haim_torchrl.human.window.calibration import default_path, load_calibration
from haim_torchrl.human.window.presets import (
    fallback,
    find_preset,
    from_sdl,
    looks_like_wheel,
)
from haim_torchrl.human.window.presses import Presses

Kind = Literal["gamepad", "wheel"]


def find_joystick(kind: Kind) -> Any:
    """The first pad or wheel that is plugged in, opened.

    Raises:
        ConsoleError: if there is none.
    """
    found: dict[Kind, list[Any]] = {"gamepad": [], "wheel": []}
    for index in range(pygame.joystick.get_count()):
        stick = pygame.joystick.Joystick(index)
        found[_kind_of(stick, index)].append(stick)
    if not found[kind]:
        raise ConsoleError(
            f"no {kind} found; plug one in, or use mentor=keyboard or mentor=browser."
        )
    return found[kind][0]


def read_axes(stick: Any) -> list[float]:
    """What the axes report, exactly -1 to 1; pygame's largest value is 32767 / 32768."""
    values = [stick.get_axis(k) for k in range(stick.get_numaxes())]
    return [value * 32768 / 32767 if value > 0.0 else value for value in values]


class Joystick:
    """A pad or wheel.

    Args:
        kind: which of the two.
        calibration: file with its mapping; None looks where calibrations are written.

    Raises:
        ConsoleError: if no such device is plugged in, or its calibration cannot be read.
    """

    def __init__(self, kind: Kind, calibration: str | Path | None = None) -> None:
        self.kind = kind
        self._calibration = calibration
        self._presses = Presses()
        self._stick = find_joystick(kind)
        self.name: str = self._stick.get_name()
        self._guid = self._stick.get_guid()
        self.mapping = self._find_mapping()
        self._start()

    @property
    def help(self) -> str:
        """What to drive with."""
        buttons = "paddles take over" if self.kind == "wheel" else "shoulder buttons take over"
        return f"{self.kind}: steer, throttle, brake   ·   {buttons}"

    @property
    def connected(self) -> bool:
        """Whether it is plugged in."""
        return self._stick is not None

    def handle(self, event: Any) -> bool:
        """Look at an event of the window; whether it was the person's doing."""
        if event.type == pygame.JOYDEVICEADDED:
            self._return(event.device_index)
        elif self._stick is None or getattr(event, "instance_id", None) != self._instance:
            return False
        elif event.type == pygame.JOYDEVICEREMOVED:
            self._stick = None
            self._presses.release_all()
        elif event.type == pygame.JOYBUTTONDOWN:
            self._presses.press(event.button)
            return True
        elif event.type == pygame.JOYBUTTONUP:
            self._presses.release(event.button)
            return True
        return event.type == pygame.JOYAXISMOTION

    def read(self) -> Controls:
        """Positions of the controls; released while it is unplugged."""
        if self._stick is None:
            return RELEASED
        stick = self._stick
        self._presses.agree({k for k in range(stick.get_numbuttons()) if stick.get_button(k)})
        return self.mapping.read(self._axes(), self._presses.look(time.monotonic()))

    def shown(self) -> None:
        """A step has been shown."""
        self._presses.shown()

    def wants_pause(self, event: Any) -> bool:
        """Whether an event is the button to pause."""
        return (
            event.type == pygame.JOYBUTTONDOWN
            and self._stick is not None
            and event.instance_id == self._instance
            and event.button in self.mapping.pause
        )

    def _axes(self) -> list[float | None]:
        """What the axes report; None until one has said anything.

        Until then it reads 0, which for a pedal that rests at an end would be half pressed.
        """
        values = read_axes(self._stick)
        self._awake.update(k for k, value in enumerate(values) if value != 0.0)
        return [value if k in self._awake else None for k, value in enumerate(values)]

    def _start(self) -> None:
        self._instance = self._stick.get_instance_id()
        self._awake: set[int] = set()
        if not self._calibrated:
            self.mapping = facing(self.mapping, self._axes())

    def _return(self, index: int) -> None:
        if self._stick is not None:
            return
        try:
            stick = pygame.joystick.Joystick(index)
        except pygame.error:  # gone again
            return
        if stick.get_guid() == self._guid:
            self._stick = stick
            self._start()

    def _find_mapping(self) -> Mapping:
        path = default_path(self._guid) if self._calibration is None else Path(self._calibration)
        self._calibrated = self._calibration is not None or path.exists()
        if self._calibrated:
            mapping = load_calibration(path)
            if mapping.kind != self.kind:
                raise ConsoleError(f"{path} is the calibration of a {mapping.kind}.")
            return mapping
        index = _index_of(self._stick)
        preset = find_preset(self.name, self._guid)
        found: Mapping | None = None
        if self.kind == "gamepad" and controller.is_controller(index):
            found = from_sdl(_sdl_mapping(index))
        if found is None and preset is not None and preset.mapping.kind == self.kind:
            found = preset.mapping
        return found or fallback(self.kind, self._stick.get_numaxes())


def _kind_of(stick: Any, index: int) -> Kind:
    preset = find_preset(stick.get_name(), stick.get_guid())
    if preset is not None:
        return preset.mapping.kind
    if looks_like_wheel(stick.get_name()):
        return "wheel"
    return "gamepad" if controller.is_controller(index) or stick.get_numaxes() > 4 else "wheel"


def _index_of(stick: Any) -> int:
    for index in range(pygame.joystick.get_count()):
        if pygame.joystick.Joystick(index).get_instance_id() == stick.get_instance_id():
            return index
    return -1


def _sdl_mapping(index: int) -> dict[str, str]:
    pad = controller.Controller(index)
    try:
        return dict(pad.get_mapping())
    finally:
        pad.quit()
