"""What a person drives with: display, joysticks, the browser's port."""

from __future__ import annotations

import os
import shutil
import socket
import sys
from pathlib import Path
from typing import Any

from haim_torchrl.doctor.check import Check

BROWSERS = (
    "firefox",
    "google-chrome",
    "google-chrome-stable",
    "chromium",
    "chromium-browser",
    "microsoft-edge",
    "brave-browser",
    "epiphany",
    "safari",
)
DRIVERS = ("x11", "wayland", "windows", "cocoa", "kmsdrm", "offscreen", "dummy")


def display() -> Check:
    """A window would be seen."""
    from haim_torchrl.human.availability import UNSEEN_DRIVERS, display_problem, video_driver

    names = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    given = ", ".join(f"{name}={os.environ[name]}" for name in names if os.environ.get(name))
    if (problem := display_problem()) is not None:
        fix = "log in at the machine's desktop, use ssh -X, or drive with mentor=browser"
        return Check("display", "info", f"none: {problem}", fix)
    driver = video_driver()
    if driver in UNSEEN_DRIVERS:
        detail = f"{given}: windows open, but nobody sees them"
        return Check("display", "warn", detail, "unset SDL_VIDEODRIVER")
    return Check("display", "ok", f"SDL opens {driver} ({given})" if given else f"SDL: {driver}")


def video_drivers() -> Check:
    """Which of SDL's video drivers open, each tried for a moment."""
    from haim_torchrl.human.availability import video_driver

    former = os.environ.get("SDL_VIDEODRIVER")
    found = []
    try:
        for driver in DRIVERS:
            needs = {"x11": "DISPLAY", "wayland": "WAYLAND_DISPLAY"}.get(driver)
            if needs is not None and not os.environ.get(needs):
                continue
            os.environ["SDL_VIDEODRIVER"] = driver
            try:
                found.append(video_driver())
            except RuntimeError:
                continue
    finally:
        os.environ.pop("SDL_VIDEODRIVER")
        if former is not None:
            os.environ["SDL_VIDEODRIVER"] = former
    return Check("video drivers", "info", ", ".join(found) or "none opens")


def joysticks() -> list[Check]:
    """Gamepads and wheels that SDL sees, and whether their axes are known."""
    from haim_torchrl.human import availability

    with availability.joysticks() as sticks:
        found = [_joystick(index, stick) for index, stick in enumerate(sticks)]
    return found or [Check("gamepads and wheels", "info", "none plugged in")]


def _joystick(index: int, stick: Any) -> Check:
    from pygame._sdl2 import controller

    from haim_torchrl.human.window.calibration import default_path
    from haim_torchrl.human.window.presets import find_preset

    name, guid = stick.get_name(), stick.get_guid()
    detail = (
        f"GUID {guid}, axes {stick.get_numaxes()}, buttons {stick.get_numbuttons()}, "
        f"hats {stick.get_numhats()}; "
    )
    calibration, preset = default_path(guid), find_preset(name, guid)
    if calibration.exists():
        return Check(name, "ok", f"{detail}calibrated in {calibration}")
    if preset is not None:
        return Check(name, "ok", f"{detail}preset {preset.model}")
    if controller.is_controller(index):
        return Check(name, "ok", f"{detail}a gamepad that SDL knows")
    fix = "python -m haim_torchrl.human.window.calibrate"
    return Check(name, "warn", f"{detail}its axes are not known and will be guessed", fix)


def permissions(folder: Path = Path("/dev/input")) -> Check:
    """The device files of gamepads and wheels can be read.

    Args:
        folder: where Linux keeps them.
    """
    from haim_torchrl.human.availability import unreadable_joysticks

    name = str(folder)
    if not sys.platform.startswith("linux"):
        return Check(name, "info", "only Linux has it")
    if not folder.exists():
        fix = "in a container: docker run --device=/dev/input, or drive with mentor=browser"
        return Check(name, "info", "not there: no gamepad or wheel can be seen", fix)
    if closed := unreadable_joysticks(str(folder)):
        fix = "add yourself to the group input: sudo usermod -aG input $USER, then log in anew"
        return Check(name, "warn", f"{', '.join(closed)} must not be read by you", fix)
    events = list(folder.glob("event*"))
    readable = sum(os.access(event, os.R_OK) for event in events)
    detail = f"{readable} of {len(events)} event devices can be read; every gamepad and wheel can"
    return Check(name, "ok", detail)


def loopback() -> Check:
    """A server on this machine can be reached from this machine."""
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            server.settimeout(2.0)
            with socket.create_connection(server.getsockname(), timeout=2.0) as client:
                connection, _ = server.accept()
                with connection:
                    client.sendall(b"haim")
                    heard = connection.recv(4)
    except OSError as error:
        fix = "let the firewall pass what stays on 127.0.0.1"
        return Check("loopback", "warn", f"127.0.0.1 does not answer: {error}", fix)
    return Check("loopback", "ok" if heard == b"haim" else "warn", "127.0.0.1 answers")


def port(host: str, number: int) -> Check:
    """The browser console's port is free.

    Args:
        host: address to listen at.
        number: the port; 0 for any.
    """
    from haim_torchrl.human.availability import Unavailable, check_page

    try:
        check_page(host, number)
    except Unavailable as error:
        return Check(f"port {number}", "warn", error.why, error.fix)
    return Check(f"port {number}", "ok", f"free at {host}")


def browsers() -> Check:
    """A browser to open the page with; one on another machine does as well."""
    found = [name for name in BROWSERS if shutil.which(name)]
    if found:
        return Check("browser", "ok", ", ".join(found))
    return Check("browser", "info", "none found here; one on another machine does as well")
