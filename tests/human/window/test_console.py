"""The window as a console: keys, focus, devices that come and go, and what it refuses."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pygame
import pytest

from haim_torchrl.envs import PlatoonEnv
from haim_torchrl.human import RELEASED, ConsoleError, Controls, Frame, Scene
from haim_torchrl.human.window import (
    Mapping,
    Pedal,
    PedalButton,
    Steering,
    WindowConsole,
    save_calibration,
)

Opened = Callable[..., WindowConsole]
PAD, WHEEL = 1, 2


@pytest.mark.parametrize(
    ("held", "controls"),
    [
        (["up"], Controls(throttle=1.0)),
        (["w", "left"], Controls(steering=-1.0, throttle=1.0)),
        (["down", "right"], Controls(steering=1.0, brake=1.0)),
        (["left", "right"], Controls()),
        (["space"], Controls(takeover=True)),
    ],
)
def test_keys_drive(opened: Opened, keys: Any, held: list[str], controls: Controls) -> None:
    console = opened()
    for name in held:
        keys.down(name)
    reading = console.read()
    assert reading.controls == controls
    assert (reading.kind, reading.connected, reading.age) == ("keys", True, 0.0)
    for name in held:
        keys.up(name)
    time.sleep(0.3)  # longer than a tap is remembered
    assert console.read().controls == RELEASED


def frames() -> tuple[Scene, Callable[[int], Frame]]:
    """A scene and its frames by number."""
    env = PlatoonEnv()
    env.reset(seed=0)
    scene = Scene(0, env.scenario_labels(), env.road_polylines())
    return scene, lambda step: Frame(0, step, env.snapshot())


def test_a_tap_between_two_readings_counts_for_one_step(opened: Opened, keys: Any) -> None:
    console, (scene, frame) = opened(), frames()
    console.begin(scene)
    console.show(frame(0))
    keys.tap("space")
    time.sleep(0.1)
    assert console.read().controls.takeover  # while waiting for the step
    assert console.read().controls.takeover  # in the step
    console.show(frame(1))
    assert not console.read().controls.takeover


def test_without_the_focus_nothing_is_held(opened: Opened, keys: Any) -> None:
    console = opened()
    keys.down("up")
    assert console.read().controls.throttle == 1.0
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    reading = console.read()
    assert not reading.connected and reading.controls == RELEASED
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSGAINED))
    reading = console.read()
    assert reading.connected and reading.controls == RELEASED


def test_p_pauses_and_goes_on_and_escape_quits(opened: Opened, keys: Any) -> None:
    console = opened()
    keys.tap("p")
    assert console.read().paused
    keys.tap("p")
    assert not console.read().paused
    keys.tap("escape")
    assert console.read().quit and console.read().quit


def test_closing_the_window_quits(opened: Opened) -> None:
    console = opened()
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    assert console.read().quit


def test_the_delay_is_bounded_by_the_time_between_two_readings(opened: Opened, keys: Any) -> None:
    console = opened()
    console.read()
    keys.down("up")
    time.sleep(0.05)
    delay = console.read().latency_ms
    assert delay is not None and 50.0 <= delay < 500.0
    assert console.read().latency_ms == delay  # nothing newer


def test_a_window_system_shut_down_by_others_shows(opened: Opened) -> None:
    console = opened()
    pygame.quit()
    time.sleep(0.02)
    reading = console.read()
    assert not reading.connected and reading.age >= 0.02


def test_a_wheel_is_found_read_lost_and_found(opened: Opened, plug: Callable[..., Any]) -> None:
    device = plug()
    console = opened("wheel")
    assert console.read().controls == RELEASED
    device.move(0, -0.5)
    device.move(2, 0.0)
    reading = console.read()
    assert reading.kind == "wheel" and reading.connected
    assert reading.controls.steering == pytest.approx(-0.5, abs=1e-3)
    assert reading.controls.throttle == pytest.approx(0.5, abs=1e-3)
    device.press(4)
    assert console.read().controls.takeover
    device.press(4, held=False)
    device.unplug()
    reading = console.read()
    assert not reading.connected and reading.controls == RELEASED

    other = plug(name="Pad", kind=PAD, axes=6, buttons=15, usb=(0x045E, 0x028E), at={})
    assert not console.read().connected
    device.plug_in()
    assert console.read().connected
    device.move(0, 1.0)
    assert console.read().controls.steering == pytest.approx(1.0, abs=1e-3)
    other.unplug()
    assert console.read().connected


def test_a_pad_is_read_by_sdls_own_mapping(opened: Opened, plug: Callable[..., Any]) -> None:
    """A virtual pad's triggers are axes 4 and 5, its right shoulder 10, start 6."""
    device = plug(name="Pad", kind=PAD, axes=6, buttons=15, usb=(0x1111, 0x2222), at={})
    console = opened("gamepad")
    assert console.read().controls == RELEASED
    device.move(0, 0.5)
    device.move(5, 0.0)
    device.press(10)
    controls = console.read().controls
    assert controls.steering == pytest.approx(0.5, abs=1e-3)
    assert (controls.throttle, controls.brake, controls.takeover) == (0.5, 0.0, True)
    device.move(5, 1.0)
    device.move(4, 1.0)
    controls = console.read().controls
    assert (controls.throttle, controls.brake) == (1.0, 1.0)
    device.press(6)
    assert console.read().paused


def test_a_pedal_that_has_not_reported_yet_is_released(
    opened: Opened, plug: Callable[..., Any]
) -> None:
    """SDL says 0 until then, which is half of the way from rest to end."""
    device = plug(at={})
    console = opened("wheel")
    assert console.read().controls == RELEASED
    device.move(2, 0.5)
    assert console.read().controls.throttle == pytest.approx(0.25, abs=1e-3)


def test_a_calibration_takes_precedence(
    opened: Opened, plug: Callable[..., Any], tmp_path: Path
) -> None:
    device = plug()
    swapped = Mapping("wheel", Steering(3), Pedal(0, 0.0, 1.0), PedalButton(2), (7,))
    console = opened("wheel", calibration=save_calibration(swapped, tmp_path / "mine.json"))
    device.move(0, 1.0)
    device.press(2)
    assert console.read().controls == Controls(steering=1.0, throttle=1.0, brake=1.0)


@pytest.mark.parametrize("device", ["gamepad", "wheel"])
def test_a_missing_device_is_said_in_one_sentence(device: Any, plug: Callable[..., Any]) -> None:
    console = WindowConsole(device)
    with pytest.raises(ConsoleError, match=f"no {device} found; plug one in"):
        console.open()
    assert not pygame.display.get_init()
    plug() if device == "gamepad" else plug(
        name="Xbox", kind=PAD, axes=6, buttons=15, usb=(1, 2), at={}
    )
    with pytest.raises(ConsoleError, match=f"no {device} found"):
        console.open()


def test_a_calibration_of_another_kind_is_refused(plug: Callable[..., Any], tmp_path: Path) -> None:
    plug()
    mapping = Mapping("gamepad", Steering(0), Pedal(2), Pedal(3))
    console = WindowConsole("wheel", save_calibration(mapping, tmp_path / "pad.json"))
    with pytest.raises(ConsoleError, match="calibration of a gamepad"):
        console.open()
    assert not pygame.display.get_init()


def test_a_missing_display_is_said_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "no_such_driver")
    with pytest.raises(ConsoleError, match=r"no display.*use mentor=browser, or mentor=expert"):
        WindowConsole().open()


def test_it_opens_once_closes_twice_and_opens_again(opened: Opened, keys: Any) -> None:
    console = opened()
    surface = pygame.display.get_surface()
    console.open()
    assert pygame.display.get_surface() is surface
    keys.tap("escape")
    assert console.read().quit
    console.close()
    console.close()
    assert not pygame.display.get_init() and not console.read().connected
    console.open()
    assert console.read().connected and not console.read().quit


def test_a_copy_by_pickle_is_closed_and_can_be_opened(opened: Opened) -> None:
    original = opened(size=(900, 720), view="north")
    copy = pickle.loads(pickle.dumps(original))
    assert not copy.read().connected
    original.close()
    copy.open()
    assert copy.read().connected and pygame.display.get_surface().get_size() == (900, 720)
    copy.close()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"device": "joystick"}, "device is 'joystick'"),
        ({"size": (300, 700)}, "at least 800 by 680"),
        ({"view": "south"}, "view is 'south'"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        WindowConsole(**settings)
