"""A window system without a screen, and joysticks without hardware that SDL takes for real."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pygame
import pytest

from haim_torchrl.human import Console
from haim_torchrl.human.window import WindowConsole

PLACES = {
    "up": (pygame.K_UP, pygame.KSCAN_UP),
    "down": (pygame.K_DOWN, pygame.KSCAN_DOWN),
    "left": (pygame.K_LEFT, pygame.KSCAN_LEFT),
    "right": (pygame.K_RIGHT, pygame.KSCAN_RIGHT),
    "w": (pygame.K_w, pygame.KSCAN_W),
    "space": (pygame.K_SPACE, pygame.KSCAN_SPACE),
    "p": (pygame.K_p, pygame.KSCAN_P),
    "escape": (pygame.K_ESCAPE, pygame.KSCAN_ESCAPE),
}


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """SDL draws into memory, and no calibration of whoever runs the tests is found."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    pygame.quit()
    yield
    pygame.quit()


class Keys:
    """Presses keys."""

    def down(self, name: str) -> None:
        self._post(pygame.KEYDOWN, name)

    def up(self, name: str) -> None:
        self._post(pygame.KEYUP, name)

    def tap(self, name: str) -> None:
        self.down(name)
        self.up(name)

    def _post(self, kind: int, name: str) -> None:
        key, scancode = PLACES[name]
        pygame.event.post(pygame.event.Event(kind, key=key, scancode=scancode, mod=0, unicode=""))


@pytest.fixture
def keys() -> Keys:
    return Keys()


@pytest.fixture
def opened() -> Iterator[Callable[..., WindowConsole]]:
    """Makes and opens a console; closes it at the end."""
    consoles: list[WindowConsole] = []

    def make(*arguments: Any, **settings: Any) -> WindowConsole:
        consoles.append(WindowConsole(*arguments, **settings))
        consoles[-1].open()
        assert isinstance(consoles[-1], Console)
        consoles[-1].read()  # what the new window reports of itself
        return consoles[-1]

    yield make
    for console in consoles:
        console.close()


class _Description(ctypes.Structure):
    """SDL_VirtualJoystickDesc, version 1."""

    _fields_ = [
        *((name, ctypes.c_uint16) for name in ("version", "type", "axes", "buttons", "hats")),
        *((name, ctypes.c_uint16) for name in ("vendor", "product", "padding")),
        *((name, ctypes.c_uint32) for name in ("button_mask", "axis_mask")),
        ("name", ctypes.c_char_p),
        *((f"pointer_{k}", ctypes.c_void_p) for k in range(7)),
    ]


class Device:
    """A joystick of SDL's own making, moved from here."""

    def __init__(self, sdl: Any, name: str, kind: int, axes: int, buttons: int, usb: Any) -> None:
        self._sdl = sdl
        self._text = _Description(1, kind, axes, buttons, 0, *usb, name=name.encode())
        if kind == 1:  # a pad: which of SDL's buttons and axes it has
            self._text.button_mask, self._text.axis_mask = (1 << buttons) - 1, (1 << axes) - 1
        self.plug_in()

    def plug_in(self) -> None:
        self._index = self._sdl.SDL_JoystickAttachVirtualEx(ctypes.byref(self._text))
        assert self._index >= 0, pygame.get_error()
        self._handle = self._sdl.SDL_JoystickOpen(self._index)

    def unplug(self) -> None:
        assert self._sdl.SDL_JoystickDetachVirtual(self._index) == 0
        self._sdl.SDL_JoystickClose(ctypes.c_void_p(self._handle))

    def move(self, axis: int, value: float) -> None:
        raw = ctypes.c_int16(round(value * 32768) if value < 0 else round(value * 32767))
        handle = ctypes.c_void_p(self._handle)
        assert self._sdl.SDL_JoystickSetVirtualAxis(handle, axis, raw) == 0

    def press(self, button: int, held: bool = True) -> None:
        handle = ctypes.c_void_p(self._handle)
        assert self._sdl.SDL_JoystickSetVirtualButton(handle, button, int(held)) == 0


G29 = "Logitech G29 Driving Force Racing Wheel"
WHEEL, PAD = 2, 1


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Device]:
    """Plugs a virtual device in, by default a Logitech G29 with its pedals released."""
    sdl = _sdl()
    # With this set the console takes the joysticks as they are, which keeps the virtual ones.
    monkeypatch.setenv("SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS", "1")

    def make(
        name: str = G29,
        kind: int = WHEEL,
        axes: int = 4,
        buttons: int = 12,
        usb: tuple[int, int] = (0x046D, 0xC24F),
        at: dict[int, float] | None = None,
    ) -> Device:
        pygame.display.init()
        pygame.joystick.init()
        device = Device(sdl, name, kind, axes, buttons, usb)
        for axis, value in ({1: 1.0, 2: 1.0, 3: 1.0} if at is None else at).items():
            device.move(axis, value)
        pygame.event.pump()
        return device

    return make


def _sdl() -> Any:
    """The library that pygame itself uses."""
    maps = Path("/proc/self/maps")
    found = re.search(r"(/\S*libSDL2-2\S*)", maps.read_text()) if maps.exists() else None
    if found is None:
        pytest.skip("SDL's library is not found, so there are no virtual joysticks")
    sdl = ctypes.CDLL(found[1])
    sdl.SDL_JoystickOpen.restype = ctypes.c_void_p
    return sdl
