"""Whether a console could open is said before, in one sentence, and leaves nothing open."""

from __future__ import annotations

import ctypes
import os
import pickle
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pygame
import pytest

from haim_torchrl.human import ConsoleError
from haim_torchrl.human import availability as here


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine without display, and pygame as a run finds it."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    pygame.quit()
    yield
    pygame.quit()


def window(device: str) -> dict[str, Any]:
    return {
        "_target_": "haim_torchrl.human.HumanMentor",
        "console": {
            "_target_": "haim_torchrl.human.window.WindowConsole",
            "device": device,
            "size": [1100, 700],
        },
    }


def page(host: str = "127.0.0.1", port: int = 0) -> dict[str, Any]:
    return {
        "_target_": "haim_torchrl.human.HumanMentor",
        "console": {
            "_target_": "haim_torchrl.human.browser.BrowserConsole",
            "host": host,
            "port": port,
        },
    }


linux_only = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="other systems always have a display"
)


@linux_only
@pytest.mark.parametrize("device", ["keyboard", "gamepad", "wheel"])
def test_without_display_other_mentors_are_offered(device: str) -> None:
    with pytest.raises(ConsoleError) as caught:
        here.check_console(window(device))
    assert str(caught.value) == (
        f"mentor.console.device={device}: there is no display for the window (DISPLAY and "
        "WAYLAND_DISPLAY are not set); take mentor=browser, which is driven from a page on any "
        "computer, or mentor=expert"
    )
    assert not pygame.display.get_init() and not pygame.joystick.get_init()


@linux_only
def test_a_display_that_does_not_answer_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":937")
    with pytest.raises(ConsoleError, match=r"DISPLAY=:937 does not answer.*mentor=browser"):
        here.check_console(window("keyboard"))


def test_a_video_driver_that_does_not_open_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "nonesuch")
    with pytest.raises(ConsoleError, match="SDL_VIDEODRIVER=nonesuch does not open"):
        here.check_console(window("keyboard"))


def test_keyboard_needs_a_window_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    here.check_console(window("keyboard"))
    assert not pygame.display.get_init() and not pygame.joystick.get_init()


@pytest.mark.parametrize("device", ["gamepad", "wheel"])
def test_nothing_plugged_in(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with here.joysticks() as found:
        if found or here.unreadable_joysticks():
            pytest.skip("a device is plugged in")
    with pytest.raises(ConsoleError) as caught:
        here.check_console(window(device))
    assert str(caught.value) == (
        f"mentor.console.device={device}: no {device} is plugged in; plug one in, or take "
        "mentor=keyboard or mentor=browser"
    )
    assert not pygame.joystick.get_init()


@pytest.fixture
def gamepad(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The name of a gamepad that SDL makes up."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    library = next(Path(pygame.__file__).parents[1].glob("pygame_ce.libs/libSDL2-2*"), None)
    if library is None:
        pytest.skip("this pygame does not bring its SDL along")
    pygame.joystick.init()
    if pygame.joystick.get_count():
        pytest.skip("a device is plugged in")
    if ctypes.CDLL(str(library)).SDL_JoystickAttachVirtual(1, 6, 15, 1) < 0:
        pytest.skip("this SDL has no virtual joysticks")
    yield pygame.joystick.Joystick(0).get_name()


def test_gamepad_plugged_in(gamepad: str) -> None:
    here.check_console(window("gamepad"))
    assert pygame.joystick.get_init() and pygame.joystick.get_count() == 1
    assert not pygame.display.get_init()


def test_another_device_than_wanted_is_named(gamepad: str) -> None:
    with pytest.raises(ConsoleError, match=f"no wheel is plugged in, only {gamepad}; plug one in"):
        here.check_console(window("wheel"))


def test_calibration_that_cannot_be_used(gamepad: str, tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    file.write_text("{}")
    settings = window("gamepad")
    settings["console"]["calibration"] = str(file)
    with pytest.raises(ConsoleError) as caught:
        here.check_console(settings)
    assert str(caught.value) == (
        f"mentor.console.calibration={file}: {file}: version is missing; "
        "calibrate anew with python -m haim_torchrl.human.window.calibrate"
    )


def test_device_that_does_not_exist() -> None:
    with pytest.raises(ConsoleError, match="device=tiller: there is no such device; take keyb"):
        here.check_console(window("tiller"))


def test_what_was_open_stays_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.init()
    pygame.joystick.init()
    here.check_console(window("keyboard"))
    with here.joysticks():
        pass
    assert pygame.display.get_init() and pygame.joystick.get_init()


@pytest.mark.skipif(os.name != "posix", reason="other systems have no such permissions")
def test_joystick_that_must_not_be_read() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        for node, mode in (("js0", 0o644), ("js1", 0), ("event7", 0), ("event8", 0)):
            (folder / node).touch()
            (folder / node).chmod(mode)
        (folder / "by-id").mkdir()
        (folder / "by-id" / "usb-Wheel-event-joystick").symlink_to("../event8")
        (folder / "by-id" / "usb-Gone-event-joystick").symlink_to("../event9")
        (folder / "by-id" / "usb-Keyboard-event-kbd").symlink_to("../event7")
        found = as_anybody(lambda: here.unreadable_joysticks(name))
    assert found == [f"{name}/event8", f"{name}/js1"]


def as_anybody(look: Callable[[], list[str]]) -> list[str]:
    """What a user without rights sees: root may read everything."""
    if os.geteuid() != 0:
        return look()
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
            os.write(sending, "\n".join(look()).encode())
        finally:
            os._exit(0)
    os.close(sending)
    with os.fdopen(receiving) as pipe:
        found = pipe.read()
    os.waitpid(child, 0)
    return found.split("\n")


def test_free_port_passes_and_stays_free() -> None:
    port = here.free_port("127.0.0.1")
    here.check_console(page(port=port))
    with socket.create_server(("127.0.0.1", port)):
        pass


def test_port_in_use_names_one_that_is_free() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with pytest.raises(here.Unavailable) as caught:
            here.check_console(page(port=port))
    error = caught.value
    assert error.setting == f"mentor.console.port={port}"
    assert error.why == "the port is in use at 127.0.0.1"
    assert str(error) == f"{error.setting}: {error.why}; {error.fix}"
    free = int(error.fix.removeprefix("take another one, such as mentor.console.port="))
    assert free != port
    here.check_console(page(port=free))


@pytest.mark.parametrize("host", ["192.0.2.1", "no-such-host.invalid"])
def test_host_of_another_machine(host: str) -> None:
    with pytest.raises(ConsoleError, match=f"mentor.console.host={host}: .*host=127.0.0.1"):
        here.check_console(page(host))


@pytest.mark.parametrize("port", [-1, 65536])
def test_port_that_does_not_exist(port: int) -> None:
    with pytest.raises(ConsoleError, match=f"mentor.console.port={port}: there is no such port"):
        here.check_console(page(port=port))


def test_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(here, "BROWSER_PACKAGES", ("starlette", "nonesuch_a", "nonesuch_b"))
    with pytest.raises(ConsoleError) as caught:
        here.check_console(page())
    assert str(caught.value) == (
        "mentor.console: the page needs nonesuch_a, nonesuch_b, not installed here; "
        'pip install "haim-torchrl[browser]"'
    )


@pytest.mark.parametrize(
    "settings",
    [
        {"_target_": "haim_torchrl.mentors.expert.ExpertMentor"},
        {"console": {"_target_": "my.own.Console", "device": "tiller"}},
        {"console": None},
        {},
    ],
)
def test_other_mentors_and_consoles_pass(settings: dict[str, Any]) -> None:
    here.check_console(settings)


def test_it_is_quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    began = time.process_time()
    here.check_console(window("keyboard"))
    here.check_console(page())
    assert time.process_time() - began < 1.0


def test_the_error_crosses_processes() -> None:
    error = here.Unavailable("mentor.console.port=1", "why", "fix")
    twin = pickle.loads(pickle.dumps(error))
    assert isinstance(twin, here.Unavailable) and str(twin) == str(error)
