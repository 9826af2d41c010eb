"""Calibrations: asked for live, written, read again, and refused field by field."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pygame
import pytest

from haim_torchrl.human import ConsoleError, Controls
from haim_torchrl.human.window import (
    Mapping,
    Pedal,
    PedalButton,
    Steering,
    load_calibration,
    save_calibration,
)
from haim_torchrl.human.window.calibrate import calibrate, main
from haim_torchrl.human.window.calibration import default_path

MAPPING = Mapping(
    "wheel", Steering(0, -0.8, 0.1, 0.9), Pedal(2, 1.0, -0.9), PedalButton(7), (4, 5), (9,)
)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = save_calibration(MAPPING, tmp_path / "new" / "wheel.json", "G29")
    assert load_calibration(path) == MAPPING


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 2}, "version is 2"),
        ({"version": None}, "version is None"),
        ({"kind": "boat"}, "kind is 'boat'"),
        ({"steering": {"axis": 0, "left": -1, "centre": 0}}, "steering.right is None"),
        ({"steering": {"axis": 0, "left": -1, "centre": 1, "right": 1}}, "steering.centre is 1"),
        ({"steering": {"left": -1, "centre": 1, "right": 1}}, "steering.axis is missing"),
        ({"throttle": {"axis": 1.5, "rest": 0, "end": 1}}, "throttle.axis is 1.5"),
        ({"throttle": {"axis": 1, "rest": "0", "end": 1}}, "throttle.rest is '0'"),
        ({"throttle": {"axis": 1, "rest": 0, "end": float("nan")}}, "throttle.end is nan"),
        ({"brake": {"axis": 1, "rest": 0.5, "end": 0.5}}, "brake.end is 0.5"),
        ({"brake": {"button": -1}}, "brake.button is -1"),
        ({"brake": 3}, "brake is 3"),
        ({"takeover": [1, "2"]}, "takeover is"),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = save_calibration(MAPPING, tmp_path / "wheel.json")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ConsoleError, match=re.escape(message)) as error:
        load_calibration(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "[]", "{", "3"])
def test_what_is_no_calibration_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "wheel.json"
    with pytest.raises(ConsoleError, match="cannot be read"):
        load_calibration(path)
    path.write_text(text)
    with pytest.raises(ConsoleError, match=r"not JSON|version is missing"):
        load_calibration(path)


class Hands:
    """Does what a calibration asks for, on a virtual device, in a time of its own."""

    def __init__(self, device: Any, plan: dict[str, list[tuple[str, int, float]]]) -> None:
        self.device, self.plan, self.now = device, plan, 0.0
        self.lines: list[str] = []
        self.todo: list[tuple[str, int, float]] = []

    def say(self, line: str) -> None:
        self.lines.append(line)
        self.todo = [step for part, steps in self.plan.items() if part in line for step in steps]

    def sleep(self, seconds: float) -> None:
        assert self.now < 60.0, f"nothing comes of it: {self.lines}"
        self.now += seconds
        if self.todo:
            what, number, value = self.todo.pop(0)
            if what == "axis":
                self.device.move(number, value)
            else:
                self.device.press(number, bool(value))

    def do(self, path: Path | None = None) -> Path:
        return calibrate("wheel", path, say=self.say, sleep=self.sleep, clock=lambda: self.now)


def way(axis: int, *places: float) -> list[tuple[str, int, float]]:
    """Ten looks from place to place."""
    return [("axis", axis, a + (b - a) * k / 10) for a, b in pairwise(places) for k in range(11)]


def test_a_calibration_finds_axes_ends_and_buttons(plug: Callable[..., Any], opened: Any) -> None:
    """Pedals rest at -1 on axes 3 and 1; all axes speak up only when the wheel is turned."""
    device = plug(name="Unknown wheel", usb=(0x1234, 0x5678), at={})
    wakes = [("axis", 1, -1.0), ("axis", 3, -1.0)]
    hands = Hands(
        device,
        {
            "fully left": [*wakes, *way(0, 0.0, -0.75)],
            "fully right": way(0, -0.75, 0.5),
            "Press the throttle": way(3, -1.0, 0.875),
            "Let go of the throttle": way(3, 0.875, -1.0),
            "Press the brake": way(1, -1.0, 1.0),
            "Let go of the brake": way(1, 1.0, -1.0),
            "Press each button": [("button", b, v) for b in (6, 7) for v in (1, 1, 0)],
        },
    )
    path = hands.do()
    mapping = load_calibration(path)
    assert path.parent.name == "haim_torchrl" and len(hands.lines) == 9
    assert mapping.takeover == (6, 7)
    for rough, exact in (
        (mapping.steering, Steering(0, -0.75, 0.0, 0.5)),
        (mapping.throttle, Pedal(3, -1.0, 0.875)),
        (mapping.brake, Pedal(1, -1.0, 1.0)),
    ):
        assert [getattr(rough, name) for name in type(exact).__slots__] == pytest.approx(
            [getattr(exact, name) for name in type(exact).__slots__], abs=1e-3
        )

    # The window finds the file by itself.
    assert default_path(pygame.joystick.Joystick(0).get_guid()) == path
    device.move(0, 0.0)
    console = opened("wheel")
    assert console.read().controls == Controls()
    device.move(3, 0.875)
    device.move(0, 0.25)
    controls = console.read().controls
    assert controls.throttle == pytest.approx(1.0, abs=1e-3)
    assert controls.steering == pytest.approx(0.5, abs=1e-3)


def test_buttons_as_pedals_and_a_shared_axis(plug: Callable[..., Any], tmp_path: Path) -> None:
    device = plug(name="Old wheel", usb=(1, 2), axes=2, at={})
    hands = Hands(
        device,
        {
            "fully left": way(0, 0.0, -1.0),
            "fully right": way(0, -1.0, 1.0),
            "Press the throttle": way(1, 0.0, -1.0),
            "Let go of the throttle": way(1, -1.0, 0.0),
            "Press the brake": [("button", 2, 1)],
            "Let go of the brake": [("button", 2, 0)],
            "Press each button": [("button", 0, 1), ("button", 0, 0)],
        },
    )
    mapping = load_calibration(hands.do(tmp_path / "old.json"))
    assert mapping.brake == PedalButton(2) and mapping.takeover == (0,)
    assert mapping.throttle == Pedal(1, 0.0, -1.0)


def test_unplugging_ends_a_calibration(plug: Callable[..., Any], tmp_path: Path) -> None:
    device = plug()
    with pytest.raises(ConsoleError, match="unplugged"):
        calibrate("wheel", tmp_path / "x.json", say=str, sleep=lambda _: device.unplug())
    assert not (tmp_path / "x.json").exists()


def test_the_command_says_that_there_is_no_device(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--device", "gamepad"]) == 1
    assert "no gamepad found" in capsys.readouterr().err
