"""Whether a console could open here, without opening it."""

from __future__ import annotations

import errno
import glob
import importlib.util
import os
import socket
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from haim_torchrl.human.console import ConsoleError

BROWSER_PACKAGES = ("starlette", "uvicorn", "websockets")
"""What the browser console is built on: the extra ``browser``."""
UNSEEN_DRIVERS = ("dummy", "offscreen", "evdev")
"""SDL's video drivers that open without a display, and whose windows nobody sees."""


class Unavailable(ConsoleError):
    """A console that cannot open here.

    Args:
        setting: the setting in question, such as ``"mentor.console.port=8000"``.
        why: what is wrong with it.
        fix: what to do instead.
    """

    def __init__(self, setting: str, why: str, fix: str) -> None:
        super().__init__(f"{setting}: {why}; {fix}")
        self.setting, self.why, self.fix = setting, why, fix

    def __reduce__(self) -> tuple[Any, ...]:
        return Unavailable, (self.setting, self.why, self.fix)


def check_console(settings: Mapping[str, Any]) -> None:
    """Say before a run whether its mentor's console could open here.

    Nothing stays open. Mentors without a console, and consoles of one's own, pass.

    Args:
        settings: the mentor's settings, with ``console`` as
            :class:`~haim_torchrl.human.HumanMentor` takes it.

    Raises:
        ConsoleError: in one sentence, with the setting and what to do instead.
    """
    console = settings.get("console")
    if not isinstance(console, Mapping):
        return
    target = str(console.get("_target_", ""))
    if target.endswith(".WindowConsole"):
        file = console.get("calibration")
        check_window(str(console.get("device", "keyboard")), None if file is None else str(file))
    elif target.endswith(".BrowserConsole"):
        check_page(str(console.get("host", "127.0.0.1")), int(console.get("port", 8765)))


def check_window(device: str, calibration: str | None = None) -> None:
    """Whether a window and its device are there.

    Args:
        device: ``"keyboard"``, ``"gamepad"`` or ``"wheel"``.
        calibration: file with the device's mapping; None looks it up.

    Raises:
        Unavailable: if one of them is not, or the calibration cannot be used.
    """
    setting = f"mentor.console.device={device}"
    if device not in ("keyboard", "gamepad", "wheel"):
        raise Unavailable(setting, "there is no such device", "take keyboard, gamepad or wheel")
    if importlib.util.find_spec("pygame") is None:
        raise Unavailable(setting, "pygame is not installed", "pip install pygame-ce")
    if (problem := display_problem()) is not None:
        fix = "take mentor=browser, which is driven from a page on any computer, or mentor=expert"
        raise Unavailable(setting, f"there is no display for the window ({problem})", fix)
    if device != "keyboard":
        with joysticks() as found:
            _check_joystick(setting, device, [stick.get_name() for stick in found], calibration)


def _check_joystick(
    setting: str, device: Any, plugged_in: list[str], calibration: str | None
) -> None:
    others = "mentor=keyboard or mentor=browser"
    closed = unreadable_joysticks()
    if not plugged_in and closed:
        raise Unavailable(
            setting,
            f"{closed[0]} is there but must not be read",
            "add yourself to the group input (sudo usermod -aG input $USER) and log in anew, or "
            f"take {others}",
        )
    if not plugged_in:
        fix = f"plug one in, or take {others}"
        raise Unavailable(setting, f"no {device} is plugged in", fix)

    from haim_torchrl.human.window.joystick import Joystick, find_joystick

    try:
        find_joystick(device)
    except ConsoleError:
        why = f"no {device} is plugged in, only {' and '.join(plugged_in)}"
        raise Unavailable(setting, why, f"plug one in, or take {others}") from None
    try:
        Joystick(device, calibration)
    except ConsoleError as error:
        raise Unavailable(
            f"mentor.console.calibration={calibration or 'null'}",
            str(error).rstrip("."),
            "calibrate anew with python -m haim_torchrl.human.window.calibrate",
        ) from None


def check_page(host: str, port: int) -> None:
    """Whether a page could be served.

    Args:
        host: address to listen at.
        port: port to listen at; 0 for any.

    Raises:
        Unavailable: if a package is missing, or nothing can listen there.
    """
    missing = [name for name in BROWSER_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise Unavailable(
            "mentor.console",
            f"the page needs {', '.join(missing)}, not installed here",
            'pip install "haim-torchrl[browser]"',
        )
    setting = f"mentor.console.port={port}"
    if not 0 <= port <= 65535:
        raise Unavailable(setting, "there is no such port", "take one of 1024 to 65535, or 0")
    error = listening_error(host, port)
    if error is None:
        return
    if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
        raise Unavailable(
            f"mentor.console.host={host}",
            "this machine has no such address",
            "take mentor.console.host=127.0.0.1, or 0.0.0.0 for all of its addresses",
        )
    if error.errno == errno.EADDRINUSE:
        free = f"take another one, such as mentor.console.port={free_port(host)}"
        raise Unavailable(setting, f"the port is in use at {host}", free)
    if error.errno in (errno.EACCES, errno.EPERM):
        raise Unavailable(
            setting,
            "the system keeps this port for itself",
            f"take one above 1024, such as mentor.console.port={free_port(host)}",
        )
    reason = error.strerror or type(error).__name__
    raise Unavailable(setting, f"cannot listen at {host} ({reason})", "take another port")


def listening_error(host: str, port: int) -> OSError | None:
    """Why nothing can listen at an address; None if something can."""
    try:
        _listen(host, port).close()
    except OSError as error:
        return error
    return None


def free_port(host: str) -> int:
    """A port that is free at an address now."""
    with _listen(host, 0) as listener:
        return int(listener.getsockname()[1])


def _listen(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, address = socket.getaddrinfo(
        host.strip("[]"), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    listener = socket.socket(family, kind, protocol)
    try:
        if os.name == "posix":  # elsewhere the option would share a port that is in use
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        listener.listen(1)
    except OSError:
        listener.close()
        raise
    return listener


def display_problem() -> str | None:
    """Why a window would not be seen, in a few words; None if it would.

    A driver that ``SDL_VIDEODRIVER`` names is taken at its word: who names ``dummy`` wants it.
    """
    wanted, display = os.environ.get("SDL_VIDEODRIVER"), os.environ.get("DISPLAY")
    missing = "DISPLAY and WAYLAND_DISPLAY are not set"
    if sys.platform.startswith("linux") and not wanted:
        # SDL also finds a display at a socket or a graphics card; without any, spare its messages.
        signs = ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR")
        if not any(map(os.environ.get, signs)) and not glob.glob("/dev/dri/card*"):
            return missing
    try:
        driver = video_driver()
    except RuntimeError:
        if wanted:
            return f"SDL_VIDEODRIVER={wanted} does not open"
    else:
        if wanted or driver not in UNSEEN_DRIVERS:
            return None
    return f"DISPLAY={display} does not answer" if display else missing


def video_driver() -> str:
    """SDL's video driver, opened for a moment unless it is open.

    Raises:
        RuntimeError: pygame's error, if none opens.
    """
    pygame = quiet_pygame()
    was_open = pygame.display.get_init()
    if not was_open:
        pygame.display.init()
    try:
        return str(pygame.display.get_driver())
    finally:
        if not was_open:
            pygame.display.quit()


@contextmanager
def joysticks() -> Iterator[list[Any]]:
    """pygame's joysticks, opened; closed afterwards unless somebody had opened them before.

    SDL needs no display for them, and calls gamepads and wheels joysticks, too.
    """
    pygame = quiet_pygame()
    from pygame._sdl2 import controller

    # Controllers are SDL's name for joysticks whose axes it knows.
    systems = [system for system in (pygame.joystick, controller) if not system.get_init()]
    for system in systems:
        system.init()
    try:
        yield [pygame.joystick.Joystick(i) for i in range(pygame.joystick.get_count())]
    finally:
        for system in reversed(systems):
            system.quit()


def unreadable_joysticks(folder: str = "/dev/input") -> list[str]:
    """Joysticks that Linux knows and this user must not read.

    Args:
        folder: where the device files are.

    Returns:
        Their device files. Keyboards and mice are none: a desktop reads those for its users.
    """
    links = glob.glob(f"{folder}/by-*/*-event-joystick")
    nodes = {str(Path(link).resolve()) for link in links} | set(glob.glob(f"{folder}/js*"))
    return sorted(node for node in nodes if os.path.exists(node) and not os.access(node, os.R_OK))


def quiet_pygame() -> Any:
    """The package pygame, without its greeting."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    import pygame

    return pygame
