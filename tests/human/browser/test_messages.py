"""Whatever a page sends, what gets through is within its ranges, and nothing raises."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.human import Controls
from haim_torchrl.human.browser.messages import (
    MAX_BYTES,
    Command,
    Input,
    Pong,
    Refusal,
    Seen,
    parse,
)

INPUT = {
    "type": "input",
    "steering": -0.25,
    "throttle": 1,
    "brake": 0.0,
    "takeover": True,
    "kind": "wheel",
    "t": 12.5,
}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda part: (
        st.lists(part, max_size=3) | st.dictionaries(st.text(max_size=5), part, max_size=3)
    ),
    max_leaves=6,
)
NAMES = st.sampled_from(["input", "pause", "resume", "quit", "drive", "pong", "seen"])
NUMBERS = st.integers() | st.floats(-2.0, 2.0) | st.floats()


def is_within_ranges(message: object) -> bool:
    if isinstance(message, Input):
        controls = message.controls
        return (
            -1.0 <= controls.steering <= 1.0
            and 0.0 <= controls.throttle <= 1.0
            and 0.0 <= controls.brake <= 1.0
            and isinstance(controls.takeover, bool)
            and message.kind in ("keys", "gamepad", "wheel")
            and math.isfinite(message.time)
        )
    if isinstance(message, Pong | Seen):
        number = message.number if isinstance(message, Pong) else message.count
        return isinstance(number, int) and 0 <= number <= 2**53
    if isinstance(message, Command):
        return message.name in ("pause", "resume", "quit", "drive")
    return isinstance(message, Refusal) and message.reason.endswith(".")


def test_an_input_is_read_as_it_was_sent() -> None:
    assert parse(json.dumps(INPUT)) == Input(Controls(-0.25, 1.0, 0.0, True), "wheel", 12.5)


@pytest.mark.parametrize("name", ["pause", "resume", "quit", "drive"])
def test_buttons(name: str) -> None:
    assert parse(json.dumps({"type": name})) == Command(name)  # type: ignore[arg-type]


def test_answers() -> None:
    assert parse('{"type":"pong","t":7}') == Pong(7)
    assert parse('{"type":"seen","n":0}') == Seen(0)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"steering": 1.01}, "steering lies in [-1, 1]."),
        ({"throttle": -0.01}, "throttle lies in [0, 1]."),
        ({"brake": 2}, "brake lies in [0, 1]."),
        ({"brake": 10**400}, "brake lies in [0, 1]."),
        ({"steering": "0"}, "steering is a number."),
        ({"steering": True}, "steering is a number."),
        ({"takeover": 1}, "takeover is true or false."),
        ({"kind": "mouse"}, "kind is none of keys, gamepad, wheel."),
        ({"kind": ["keys"]}, "kind is none of keys, gamepad, wheel."),
        ({"t": -1}, "t lies in [0, 9.0072e+15]."),
        ({"steering": math.nan}, "NaN is no number."),
        ({"steering": -math.inf}, "-Infinity is no number."),
        ({"type": "steer"}, "type is none of input, pause, resume, quit, drive, pong, seen."),
        ({"type": {}}, "type is none of input, pause, resume, quit, drive, pong, seen."),
        ({"speed": 1}, "A message of type input has brake, kind, steering, t, takeover, throttle."),
    ],
)
def test_what_is_wrong_is_said(change: dict, reason: str) -> None:
    assert parse(json.dumps(INPUT | change)) == Refusal(reason)


@pytest.mark.parametrize("name", sorted(INPUT.keys() - {"type"}))
def test_no_entry_may_be_missing(name: str) -> None:
    entries = {key: value for key, value in INPUT.items() if key != name}
    assert isinstance(parse(json.dumps(entries)), Refusal)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "This is no JSON."),
        ("{", "This is no JSON."),
        ("[" * 4000, "This is no JSON."),
        ('{"type":"pong","t":1e999}', "t is a whole number."),
        ("[]", "A message is a JSON object."),
        (" " * (MAX_BYTES + 1), "A message has at most 4096 bytes."),
        (b'{"type":"pause"}', "Messages are text, not bytes."),
        ('{"type":"pause","why":1}', "A message of type pause has no further entries."),
        ('{"type":"seen","n":1.5}', "n is a whole number."),
    ],
)
def test_what_is_no_message(text: str | bytes, reason: str) -> None:
    assert parse(text) == Refusal(reason)


@given(value=JSON)
def test_any_json_is_checked(value: object) -> None:
    assert is_within_ranges(parse(json.dumps(value)))


@given(entries=st.dictionaries(st.sampled_from(sorted({*INPUT, "n", "x"})), JSON | NUMBERS | NAMES))
def test_anything_like_a_message_is_checked(entries: dict) -> None:
    assert is_within_ranges(parse(json.dumps(entries)))


@given(
    name=st.sampled_from(["input", "pong", "seen"]),
    numbers=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS),
)
def test_any_number_is_checked(name: str, numbers: tuple[float, ...]) -> None:
    values = dict(zip(("steering", "throttle", "brake", "t"), numbers))
    whole = {"input": INPUT | values, "pong": {"t": numbers[3]}, "seen": {"n": numbers[3]}}[name]
    assert is_within_ranges(parse(json.dumps(whole | {"type": name})))


@given(text=st.text() | st.binary())
def test_any_text_is_checked(text: str | bytes) -> None:
    assert is_within_ranges(parse(text))
