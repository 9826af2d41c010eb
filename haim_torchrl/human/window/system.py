"""Starting and stopping the window system."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pygame
from pygame._sdl2 import controller

from haim_torchrl.human.console import ConsoleError

UNSEEN = ("dummy", "offscreen")
"""SDL's drivers without a screen; the latter it takes by itself where there is no screen."""
ANYWHERE = "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS"


def open_display(size: tuple[int, int]) -> None:
    """Open a window.

    Args:
        size: its width and height in pixels.

    Raises:
        ConsoleError: if there is no display, and none of the drivers without one was asked for.
    """
    asked = os.environ.get("SDL_VIDEODRIVER")
    try:
        pygame.display.init()
        if pygame.display.get_driver() in UNSEEN and not asked:
            raise pygame.error("only drivers without a screen are available")
        pygame.display.set_mode(size, pygame.RESIZABLE)
    except pygame.error as error:
        where = "" if sys.platform in ("win32", "darwin") else " in DISPLAY or WAYLAND_DISPLAY"
        raise ConsoleError(
            f"no display{where} ({error}); use mentor=browser, or mentor=expert."
        ) from error
    pygame.display.set_caption("HAIM-DRL")


def open_joysticks() -> None:
    """Start SDL's joysticks such that they report while another window has the focus, too."""
    if not pygame.joystick.get_init() or ANYWHERE not in os.environ:
        _stop_joysticks()  # they look at the variable when they start
    with environment(ANYWHERE, "1"):
        pygame.joystick.init()
        controller.init()


def shut_down() -> None:
    """Close the window and let go of the devices."""
    _stop_joysticks()
    pygame.display.quit()


def _stop_joysticks() -> None:
    if controller.get_init():
        controller.quit()
    pygame.joystick.quit()


@contextmanager
def environment(name: str, value: str) -> Iterator[None]:
    """Set an environment variable for a while, if the user has not set it."""
    if name in os.environ:
        yield
        return
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]
