"""The window as a console: shows the scene, and is steered with keys, a pad or a wheel."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any, Literal, TypeAlias

import pygame

from haim_torchrl.human.console import Frame, Scene
from haim_torchrl.human.controls import DeviceKind, Reading
from haim_torchrl.human.window.draw import Painter
from haim_torchrl.human.window.hud import HEIGHT
from haim_torchrl.human.window.joystick import Joystick
from haim_torchrl.human.window.keyboard import Keyboard
from haim_torchrl.human.window.system import UNSEEN, open_display, open_joysticks, shut_down

DeviceName: TypeAlias = Literal["keyboard", "gamepad", "wheel"]

TROUBLE: dict[DeviceKind, str] = {
    "keys": "click this window to go on",
    "gamepad": "plug the gamepad in to go on",
    "wheel": "plug the wheel in to go on",
}
"""What to do when the device is not there."""
KINDS: dict[DeviceName, DeviceKind] = {"keyboard": "keys", "gamepad": "gamepad", "wheel": "wheel"}


class WindowConsole:
    """A window that a person drives in; a :class:`~haim_torchrl.human.Console`.

    P or a pad's start button pauses and goes on; Esc or closing the window ends the run. A keyboard
    is there while the window has the focus, a pad or wheel while it is plugged in. Forces are not
    fed back to a wheel.

    Nothing tells when an input reached the computer: ``latency_ms`` is the time between the look
    that found the newest one and the look before, which is the longest it can have waited.

    It can be pickled; the copy is closed.

    Args:
        device: what the person drives with.
        calibration: file written by ``python -m haim_torchrl.human.window.calibrate``; without it
            the one in ``~/.config/haim_torchrl`` is used, else a preset.
        size: width and height of the window at first, in pixels.
        view: what is up in the window, the vehicle's heading or +y ("north").

    Raises:
        ValueError: if an argument is none of those.
    """

    def __init__(
        self,
        device: DeviceName = "keyboard",
        calibration: str | os.PathLike[str] | None = None,
        size: tuple[int, int] = (1100, 700),
        view: Literal["heading", "north"] = "heading",
    ) -> None:
        if device not in KINDS:
            raise ValueError(f"device is {device!r}: it is one of {', '.join(KINDS)}.")
        if size[0] < 800 or size[1] < HEIGHT:
            raise ValueError(f"size is {tuple(size)}: it is at least 800 by {HEIGHT} pixels.")
        if view not in ("heading", "north"):
            raise ValueError(f'view is {view!r}: it is "heading" or "north".')
        self.device: DeviceName = device
        self.calibration = None if calibration is None else Path(calibration)
        self.size = (int(size[0]), int(size[1]))
        self.view = view
        self._clear()

    def _clear(self) -> None:
        self._input: Keyboard | Joystick | None = None
        self._painter: Painter | None = None
        self._scene: Scene | None = None
        self._frame: Frame | None = None
        self._paused = self._quit = False
        self._pumped: float | None = None
        self._latency: float | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("device", "calibration", "size", "view")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._clear()

    def open(self) -> None:
        """Open window and device; does nothing if they are.

        Raises:
            ConsoleError: if there is no display, no such device, or no valid calibration.
        """
        if self._input is not None:
            return
        try:
            open_display(self.size)
            if self.device == "keyboard":
                unseen = pygame.display.get_driver() in UNSEEN
                self._input = Keyboard(focused=unseen or pygame.key.get_focused())
            else:
                open_joysticks()
                self._input = Joystick(self.device, self.calibration)
        except BaseException:
            shut_down()
            self._clear()
            raise
        self._painter = Painter(self._input.help, self._input.name, self.view)
        self._pumped = time.monotonic()

    def read(self) -> Reading:
        """What the person does now."""
        kind = KINDS[self.device]
        if self._input is None:
            return Reading(kind=kind, paused=self._paused, quit=self._quit)
        now = time.monotonic()
        before = now if self._pumped is None else self._pumped
        try:
            touched = [self._handle(event) for event in pygame.event.get()]
            controls = self._input.read()
        except pygame.error:  # somebody else has shut the window system down
            return Reading(kind=kind, age=now - before, paused=self._paused, quit=self._quit)
        if any(touched):
            self._latency = 1e3 * (now - before)
        self._pumped = now
        return Reading(
            controls=controls,
            kind=kind,
            connected=self._input.connected,
            trouble="" if self._input.connected else TROUBLE[kind],
            age=0.0,
            latency_ms=self._latency,
            paused=self._paused,
            quit=self._quit,
        )

    def begin(self, scene: Scene) -> None:
        """Show a new episode."""
        self._scene = scene
        if self._painter is not None:
            self._painter.begin(scene)

    def show(self, frame: Frame) -> None:
        """Show a step."""
        if self._input is None or self._painter is None or self._scene is None:
            return
        last, self._frame = self._frame, frame
        if last is not None and (frame.episode, frame.step) != (last.episode, last.step):
            self._input.shown()
        surface = pygame.display.get_surface() if pygame.display.get_init() else None
        if surface is not None:
            self._painter.draw(surface, frame)
            pygame.display.flip()

    def close(self) -> None:
        """Close the window; does nothing if it is closed."""
        if self._input is not None:
            shut_down()
        self._clear()

    def _handle(self, event: Any) -> bool:
        """Look at an event; whether it was the person's doing."""
        assert self._input is not None
        escape = event.type == pygame.KEYDOWN and event.key == pygame.K_ESCAPE
        if escape or event.type in (pygame.QUIT, pygame.WINDOWCLOSE):
            self._quit = True
        elif (event.type == pygame.KEYDOWN and event.key == pygame.K_p) or self._input.wants_pause(
            event
        ):
            self._paused = not self._paused
        elif event.type in (pygame.WINDOWEXPOSED, pygame.WINDOWRESIZED) and self._frame is not None:
            self.show(self._frame)
        return self._input.handle(event)
