"""Display, joysticks and port, in conditions that are made here."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pygame
import pytest

from haim_torchrl.doctor import inputs
from haim_torchrl.doctor.live import bar, describe, watch
from haim_torchrl.human.window.calibration import default_path


def test_dummy_display_is_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.quit()
    check = inputs.display()
    assert (check.status, check.fix) == ("warn", "unset SDL_VIDEODRIVER")
    assert "nobody sees" in check.detail


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others always have one")
def test_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    pygame.quit()
    check = inputs.display()
    assert check.status == "info" and "mentor=browser" in check.fix


def test_video_drivers_leave_the_setting_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "offscreen")
    assert "dummy" in inputs.video_drivers().detail
    assert inputs.os.environ["SDL_VIDEODRIVER"] == "offscreen"
    assert not pygame.display.get_init()


def test_a_joystick_is_listed(attach: Callable[[int, int, int], None]) -> None:
    before = len(inputs.joysticks()) if pygame.joystick.get_count() else 0
    attach(4, 11, 1)
    found = inputs.joysticks()
    assert len(found) == before + 1
    assert "axes 4, buttons 11, hats 1; " in found[-1].detail
    assert "GUID " in found[-1].detail


def test_a_calibrated_joystick(
    attach: Callable[[int, int, int], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    attach(3, 2, 0)
    stick = pygame.joystick.Joystick(pygame.joystick.get_count() - 1)
    file = default_path(stick.get_guid())
    assert "calibrated" not in inputs.joysticks()[-1].detail
    file.parent.mkdir(parents=True)
    file.write_text("{}")
    check = inputs.joysticks()[-1]
    assert check.status == "ok" and check.detail.endswith(f"calibrated in {file}")


def test_no_joystick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.quit()
    pygame.joystick.init()
    if pygame.joystick.get_count():
        pytest.skip("one is plugged in")
    (check,) = inputs.joysticks()
    assert (check.status, check.detail) == ("info", "none plugged in")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has device files")
def test_device_files(tmp_path: Path) -> None:
    (tmp_path / "event0").touch()
    check = inputs.permissions(tmp_path)
    assert check.status == "ok" and "1 of 1 event devices" in check.detail
    assert inputs.permissions(tmp_path / "none").status == "info"


def test_port(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
        taken = inputs.port("127.0.0.1", number)
    assert taken.status == "warn" and "mentor.console.port=" in taken.fix
    assert inputs.port("127.0.0.1", number).status == "ok"


def test_loopback() -> None:
    assert inputs.loopback().status == "ok"


def test_browsers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert inputs.browsers().status == "info"
    (tmp_path / "firefox").touch(mode=0o755)
    assert inputs.browsers().detail == "firefox"


@pytest.mark.parametrize(
    ("value", "filled"), [(0.0, (0, 0)), (1.0, (0, 20)), (-0.25, (5, 0)), (-7.0, (20, 0))]
)
def test_bars(value: float, filled: tuple[int, int]) -> None:
    left, right = bar(value)[1:-1].split("|")
    assert (left.count("#"), right.count("#")) == filled
    assert len(left) == len(right) == 20


def test_live_view(attach: Callable[[int, int, int], None], capsys: Any) -> None:
    attach(2, 3, 1)
    stick = pygame.joystick.Joystick(pygame.joystick.get_count() - 1)
    lines = describe([stick]).splitlines()
    assert lines[0].startswith(stick.get_name())
    assert [line.split()[:3] for line in lines[1:3]] == [
        ["axis", "0", "+0.000"],
        ["axis", "1", "+0.000"],
    ]
    assert lines[3:] == ["  buttons pressed: -", "  hats: (0, 0)"]
    assert watch(0.2)
    assert stick.get_name() in capsys.readouterr().out
