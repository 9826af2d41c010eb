"""Known devices are found by number and by name, and SDL's own mappings are understood."""

from __future__ import annotations

import pytest

from haim_torchrl.human import Controls
from haim_torchrl.human.window import Pedal, PedalButton
from haim_torchrl.human.window.presets import fallback, find_preset, from_sdl, looks_like_wheel


@pytest.mark.parametrize(
    ("name", "guid", "model"),
    [
        ("Logitech G29 Driving Force Racing Wheel", "", "Logitech G29"),
        ("Some other name", "030000006d0400004fc2000011010000", "Logitech G29"),
        ("Logitech G920 Driving Force Racing Wheel", "", "Logitech G920"),
        (
            "Logitech G923 Racing Wheel for Xbox One and PC",
            "030000006d0400006ec2000011010000",
            "Logitech G923 (Xbox)",
        ),
        ("Logitech G923 Racing Wheel", "", "Logitech G923 (PlayStation)"),
        ("T150RS Wheel", "030000004f04000077b6000000000000", "Thrustmaster T150"),
        ("Thrustmaster T300RS Racing wheel", "", "Thrustmaster T300"),
        ("Xbox Series X Controller", "", "Xbox"),
        ("Microsoft X-Box 360 pad", "", "Xbox"),
        ("DualSense Wireless Controller", "", "DualShock 4 or DualSense"),
        ("Sony Interactive Entertainment Wireless Controller", "", "DualShock 4 or DualSense"),
    ],
)  # fmt: skip
def test_a_device_is_recognised(name: str, guid: str, model: str) -> None:
    preset = find_preset(name, guid)
    assert preset is not None and preset.model == model


def test_an_unknown_device_has_no_preset() -> None:
    assert find_preset("Nintendo Switch Pro Controller", "030000007e0500000920000011810000") is None
    assert looks_like_wheel("FANATEC CSL Elite Wheel Base") and not looks_like_wheel("Pro Pad")


def test_released_pedals_of_a_g29_are_released() -> None:
    """Its four axes: steering, clutch, throttle, brake; pedals rest at +1."""
    preset = find_preset("G29")
    assert preset is not None
    assert preset.mapping.read([0.0, 1.0, 1.0, 1.0], ()) == Controls()
    assert preset.mapping.read([-1.0, 1.0, 0.0, 1.0], {4}) == Controls(-1.0, 0.5, 0.0, True)
    assert preset.mapping.read([0.5, -1.0, 1.0, -1.0], ()) == Controls(0.5, 0.0, 1.0)


def test_sdl_mappings() -> None:
    entries = {"a": "b0", "leftshoulder": "b9", "rightshoulder": "b10", "start": "b6"}
    sticks = {"leftx": "a0", "lefttrigger": "a4", "righttrigger": "a5"}
    mapping = from_sdl(entries | sticks)
    assert mapping is not None
    assert (mapping.takeover, mapping.pause) == ((9, 10, 0), (6,))
    assert mapping.read([0.5, 0, 0, 0, -1.0, 0.0], {10}) == Controls(0.5, 0.5, 0.0, True)

    odd = from_sdl({"leftx": "a3~", "lefttrigger": "-a2", "righttrigger": "+a2"})
    assert odd is not None and odd.takeover == ()
    assert odd.read([0, 0, -0.5, 1.0], ()) == Controls(-1.0, 0.0, 0.5)

    digital = from_sdl(sticks | {"lefttrigger": "b6", "righttrigger": "a5~"})
    assert digital is not None
    assert digital.brake == PedalButton(6) and digital.throttle == Pedal(5, 1.0, -1.0)
    assert from_sdl({"leftx": "a0", "lefttrigger": "a4"}) is None


@pytest.mark.parametrize("kind", ["gamepad", "wheel"])
@pytest.mark.parametrize("axes", [1, 2, 3, 4, 5, 6, 8])
def test_the_fallback_uses_axes_that_exist(kind, axes: int) -> None:
    mapping = fallback(kind, axes)
    assert mapping.kind == kind and mapping.takeover
    for pedal in (mapping.throttle, mapping.brake):
        assert isinstance(pedal, Pedal) and pedal.axis < max(axes, 2)
