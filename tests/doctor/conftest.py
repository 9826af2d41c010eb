"""A gamepad that SDL itself makes up."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from pathlib import Path

import pygame
import pytest


def sdl() -> ctypes.CDLL:
    """The SDL that pygame uses."""
    places = Path(pygame.__file__).parents[1].glob("pygame_ce.libs/libSDL2-2*")
    library = next(places, None)
    if library is None:
        pytest.skip("this pygame does not bring its SDL along")
    return ctypes.CDLL(str(library))


@pytest.fixture
def attach(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int, int, int], None]]:
    """Plugs in a joystick with so many axes, buttons and hats."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    library = sdl()
    pygame.quit()
    pygame.joystick.init()

    def plug_in(axes: int, buttons: int, hats: int) -> None:
        if library.SDL_JoystickAttachVirtual(1, axes, buttons, hats) < 0:
            pytest.skip("this SDL has no virtual joysticks")

    yield plug_in
    pygame.quit()
