"""Mappings of common pads and wheels.

Which number an axis has depends on the driver, too. The wheels' numbers here are those of the Linux
kernel; a pad's are used only where SDL knows no mapping for it. A calibration takes precedence.
"""

from __future__ import annotations

import re
from collections.abc import Mapping as Dictionary
from typing import Literal, NamedTuple

from haim_torchrl.human.window.axes import Mapping, Pedal, PedalButton, Steering


class Preset(NamedTuple):
    """A mapping, and the devices it is for.

    Attributes:
        model: what people call the device.
        name: regular expression that the device's name contains, without regard to case.
        usb: vendor and product numbers, four hexadecimal digits each.
        mapping: its mapping.
    """

    model: str
    name: str
    usb: tuple[tuple[str, str], ...]
    mapping: Mapping


def _wheel(throttle: int, brake: int, takeover: tuple[int, ...], pause: int) -> Mapping:
    return Mapping(
        "wheel",
        Steering(0),
        Pedal(throttle, rest=1.0, end=-1.0),
        Pedal(brake, rest=1.0, end=-1.0),
        takeover,
        (pause,),
    )


def _pad(throttle: int, brake: int, takeover: tuple[int, ...], pause: int) -> Mapping:
    return Mapping("gamepad", Steering(0), Pedal(throttle), Pedal(brake), takeover, (pause,))


PRESETS = (
    Preset("Logitech G29", r"\bG29\b", (("046d", "c24f"),), _wheel(2, 3, (4, 5), 9)),
    Preset("Logitech G920", r"\bG920\b", (("046d", "c262"),), _wheel(1, 2, (4, 5), 6)),
    Preset(
        "Logitech G923 (Xbox)",
        r"\bG923\b.*(xbox|\bX\b)",
        (("046d", "c26d"), ("046d", "c26e")),
        _wheel(1, 2, (4, 5), 6),
    ),
    Preset(
        "Logitech G923 (PlayStation)",
        r"\bG923\b",
        (("046d", "c266"), ("046d", "c267")),
        _wheel(2, 3, (4, 5), 9),
    ),
    Preset("Thrustmaster T150", r"\bT150\b", (("044f", "b677"),), _wheel(2, 1, (0, 1), 7)),
    Preset(
        "Thrustmaster T300",
        r"\bT300",
        (("044f", "b66e"), ("044f", "b66f"), ("044f", "b66d")),
        _wheel(2, 1, (0, 1), 7),
    ),
    Preset("Xbox", r"x-?box|xinput", (), _pad(5, 2, (4, 5, 0), 7)),
    Preset(
        "DualShock 4 or DualSense",
        r"dualshock|dualsense|ps[45] controller|^(sony interactive .*)?wireless control",
        (("054c", "05c4"), ("054c", "09cc"), ("054c", "0ce6"), ("054c", "0df2")),
        _pad(5, 2, (4, 5, 0), 9),
    ),
)
"""Tried in turn, first by numbers, then by name."""


def find_preset(name: str, guid: str = "") -> Preset | None:
    """The preset of a device, None if there is none.

    Args:
        name: what the device calls itself.
        guid: SDL's identification, 32 hexadecimal digits with vendor and product in them.
    """
    usb = _usb_numbers(guid)
    for preset in PRESETS:
        if usb in preset.usb:
            return preset
    for preset in PRESETS:
        if re.search(preset.name, name, re.IGNORECASE):
            return preset
    return None


def looks_like_wheel(name: str) -> bool:
    """Whether an unknown device's name says that it is a wheel."""
    return re.search(r"wheel|racing|driving force|lenkrad", name, re.IGNORECASE) is not None


def from_sdl(text: Dictionary[str, str]) -> Mapping | None:
    """SDL's own mapping of a pad: left stick, triggers, shoulder buttons and A.

    Args:
        text: its entries, such as ``{"leftx": "a0", "righttrigger": "a5", "a": "b0"}``.

    Returns:
        None where it lacks the stick or a trigger.
    """
    stick = re.fullmatch(r"a(\d+)(~?)", text.get("leftx", ""))
    throttle, brake = _trigger(text.get("righttrigger")), _trigger(text.get("lefttrigger"))
    if stick is None or throttle is None or brake is None:
        return None
    side = -1.0 if stick[2] else 1.0
    buttons = [
        tuple(int(text[name][1:]) for name in names if re.fullmatch(r"b\d+", text.get(name, "")))
        for names in (("leftshoulder", "rightshoulder", "a"), ("start",))
    ]
    return Mapping("gamepad", Steering(int(stick[1]), -side, 0.0, side), throttle, brake, *buttons)


def fallback(kind: Literal["gamepad", "wheel"], axes: int) -> Mapping:
    """The likeliest mapping of an unknown device.

    Two axes are taken for a wheel with both pedals on one axis, or for a stick.

    Args:
        kind: pad or wheel.
        axes: how many it has.
    """
    if axes < 3:
        return Mapping(
            kind, Steering(0), Pedal(1, rest=0.0, end=-1.0), Pedal(1, rest=0.0, end=1.0), (0, 4, 5)
        )
    if kind == "wheel":
        return _wheel(*((1, 2) if axes == 3 else (2, 3)), takeover=(4, 5), pause=9)
    if axes < 6:  # no triggers: the right stick's or the left one's other axis
        return Mapping(
            kind, Steering(0), Pedal(1, rest=0.0, end=-1.0), Pedal(1, rest=0.0, end=1.0), (4, 5, 0)
        )
    return _pad(5, 2, (4, 5, 0), 7)


def _usb_numbers(guid: str) -> tuple[str, str]:
    """Vendor and product, which a guid holds with their bytes exchanged."""
    swapped = [guid[k + 2 : k + 4] + guid[k : k + 2] for k in (8, 16)]
    return swapped[0].lower(), swapped[1].lower()


def _trigger(text: str | None) -> Pedal | PedalButton | None:
    match = re.fullmatch(r"([+-]?)([ab])(\d+)(~?)", text or "")
    if match is None:
        return None
    sign, what, number, inverted = match.groups()
    if what == "b":
        return PedalButton(int(number))
    rest, end = {"": (-1.0, 1.0), "+": (0.0, 1.0), "-": (0.0, -1.0)}[sign]
    return Pedal(int(number), *((end, rest) if inverted else (rest, end)))
