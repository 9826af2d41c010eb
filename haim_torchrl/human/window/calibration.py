"""Calibrations as files: one mapping in JSON, with a version, checked field by field."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from haim_torchrl.human.console import ConsoleError
from haim_torchrl.human.window.axes import Mapping, Pedal, PedalButton, Steering

VERSION = 1
T = TypeVar("T")


def default_path(guid: str) -> Path:
    """Where the calibration of a device lies: ``~/.config/haim_torchrl/<guid>.json``.

    Args:
        guid: SDL's identification of the device.
    """
    home = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(home) / "haim_torchrl" / f"{guid}.json"


def save_calibration(mapping: Mapping, path: str | os.PathLike[str], device: str = "") -> Path:
    """Write a mapping.

    Args:
        mapping: what to write.
        path: file to write; its folder is made.
        device: the device's name, for whoever opens the file.
    """
    steering = mapping.steering
    content = {
        "version": VERSION,
        "device": device,
        "kind": mapping.kind,
        "steering": {name: getattr(steering, name) for name in Steering.__slots__},
        "throttle": _pedal_fields(mapping.throttle),
        "brake": _pedal_fields(mapping.brake),
        "takeover": list(mapping.takeover),
        "pause": list(mapping.pause),
    }
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return target


def load_calibration(path: str | os.PathLike[str]) -> Mapping:
    """Read a mapping.

    Raises:
        ConsoleError: in one sentence that names file and field, if it is no calibration.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ConsoleError(f"{path} cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise ConsoleError(f"{path} is not JSON: {error}.") from error
    try:
        return _mapping(content)
    except _FieldError as error:
        raise ConsoleError(f"{path}: {error}") from error


class _FieldError(ValueError):
    """A field that is missing or wrong."""


def _mapping(content: Any) -> Mapping:
    version = _get(content, "version", int)
    if version != VERSION:
        raise _FieldError(f"version is {version}, this reads {VERSION}; calibrate anew.")
    kind = _get(content, "kind", str)
    if kind not in ("gamepad", "wheel"):
        raise _FieldError(f'kind is {kind!r}: it is "gamepad" or "wheel".')
    return Mapping(
        kind,  # type: ignore[arg-type]
        _steering(_get(content, "steering", dict)),
        _pedal(_get(content, "throttle", dict), "throttle"),
        _pedal(_get(content, "brake", dict), "brake"),
        _buttons(content, "takeover"),
        _buttons(content, "pause"),
    )


def _steering(fields: dict[str, Any]) -> Steering:
    axis = _get(fields, "axis", int, "steering.")
    places = [_number(fields, name, "steering.") for name in ("left", "centre", "right")]
    return _made("steering", lambda: Steering(axis, *places))


def _pedal(fields: dict[str, Any], name: str) -> Pedal | PedalButton:
    if "button" in fields:
        button = _get(fields, "button", int, f"{name}.")
        return _made(name, lambda: PedalButton(button))
    axis = _get(fields, "axis", int, f"{name}.")
    rest, end = _number(fields, "rest", f"{name}."), _number(fields, "end", f"{name}.")
    return _made(name, lambda: Pedal(axis, rest, end))


def _buttons(content: dict[str, Any], name: str) -> tuple[int, ...]:
    buttons = _get(content, name, list)
    if not all(type(button) is int and button >= 0 for button in buttons):
        raise _FieldError(f"{name} is {buttons}: it is a list of button numbers, from 0.")
    return tuple(buttons)


def _made(name: str, make: Callable[[], T]) -> T:
    try:
        return make()
    except ValueError as error:
        raise _FieldError(f"{name}.{error}") from error


def _number(fields: dict[str, Any], name: str, prefix: str) -> float:
    value = fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= 1.5:
        raise _FieldError(f"{prefix}{name} is {value!r}: it is a number between -1 and 1.")
    return float(value)


def _get(fields: Any, name: str, kind: type[T], prefix: str = "") -> T:
    if not isinstance(fields, dict) or name not in fields:
        raise _FieldError(f"{prefix}{name} is missing.")
    value = fields[name]
    if type(value) is not kind:
        raise _FieldError(f"{prefix}{name} is {value!r}, not of type {kind.__name__}.")
    return value


def _pedal_fields(pedal: Pedal | PedalButton) -> dict[str, Any]:
    return {name: getattr(pedal, name) for name in type(pedal).__slots__}
