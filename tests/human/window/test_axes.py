"""The mathematics of axes: ends exact, monotone, clipped, whichever way a device reports."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from haim_torchrl.human import Controls
from haim_torchrl.human.window import Mapping, Pedal, PedalButton, Steering
from haim_torchrl.human.window.axes import SHORTEST, facing, travelled

raw = st.floats(-1.0, 1.0)
wide = st.floats(-3.0, 3.0)


@st.composite
def ways(draw: st.DrawFn) -> tuple[float, float]:
    rest, end = draw(raw), draw(raw)
    assume(abs(end - rest) >= SHORTEST)
    return rest, end


@settings(deadline=None)
@given(ways())
def test_the_ends_are_exact(way: tuple[float, float]) -> None:
    assert travelled(way[0], *way) == 0.0
    assert travelled(way[1], *way) == 1.0


@settings(deadline=None)
@given(ways(), wide, wide)
def test_further_towards_the_end_is_never_less(
    way: tuple[float, float], one: float, other: float
) -> None:
    near, far = sorted((one, other), reverse=way[1] < way[0])
    assert 0.0 <= travelled(near, *way) <= travelled(far, *way) <= 1.0


@settings(deadline=None)
@given(ways())
def test_it_is_linear_between(way: tuple[float, float]) -> None:
    rest, end = way
    assert travelled(rest + 0.25 * (end - rest), rest, end) == pytest.approx(0.25)


@settings(deadline=None)
@given(raw, st.floats(SHORTEST, 1.0), st.floats(SHORTEST, 1.0), st.booleans(), wide, wide)
def test_steering_is_exact_at_three_places_and_monotone(
    centre: float, one: float, other: float, mirrored: bool, here: float, there: float
) -> None:
    assume(one > SHORTEST + 1e-9 and other > SHORTEST + 1e-9)
    side = -1.0 if mirrored else 1.0
    steering = Steering(0, centre - side * one, centre, centre + side * other)
    read = [steering.read([value]) for value in (steering.left, centre, steering.right)]
    assert read == [-1.0, 0.0, 1.0]
    left, right = sorted((here, there), reverse=mirrored)
    assert -1.0 <= steering.read([left]) <= steering.read([right]) <= 1.0


def test_two_pedals_may_share_an_axis() -> None:
    """Values by hand: an axis that rests at 0, up for the throttle."""
    mapping = Mapping("wheel", Steering(0), Pedal(1, 0.0, -1.0), Pedal(1, 0.0, 1.0), (4, 5))
    assert mapping.read([0.5, -0.25], {5}) == Controls(0.5, 0.25, 0.0, True)
    assert mapping.read([-1.0, 0.75], {3}) == Controls(-1.0, 0.0, 0.75, False)


def test_a_silent_axis_is_at_rest() -> None:
    """Before its first report an axis reads 0, which for this pedal is half pressed."""
    mapping = Mapping("wheel", Steering(0), Pedal(1, 1.0, -1.0), PedalButton(2))
    assert mapping.read([None, 0.0], ()).throttle == 0.5
    assert mapping.read([None, None], {2}) == Controls(brake=1.0)
    assert mapping.read([], ()) == Controls()


def test_pedals_that_rest_at_the_other_end_are_turned_round() -> None:
    mapping = Mapping("wheel", Steering(0), Pedal(2, 1.0, -1.0), Pedal(3, 1.0, -1.0))
    turned = facing(mapping, [0.0, 0.0, -1.0, -1.0])
    assert (turned.throttle, turned.brake) == (Pedal(2, -1.0, 1.0), Pedal(3, -1.0, 1.0))
    assert facing(mapping, [0.0, 0.0, -1.0, 1.0]) == mapping  # a foot on one of them
    assert facing(mapping, [0.0, 0.0, None, None]) == mapping
    shared = Mapping("wheel", Steering(0), Pedal(1, 0.0, -1.0), Pedal(1, 0.0, 1.0))
    assert facing(shared, [0.0, 1.0]) == shared


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Steering(0, -1.0, -0.95, 1.0), "centre is -0.95"),
        (lambda: Steering(0, 0.5, 0.0, 1.0), "centre is 0.0"),
        (lambda: Steering(-1), "axis is -1"),
        (lambda: Pedal(1, 0.0, 0.05), "end is 0.05"),
        (lambda: PedalButton(True), "button is True"),
        (lambda: Mapping("wheel", Steering(0), Pedal(1), Pedal(2), (-4,)), "takeover is -4"),
    ],
)
def test_what_cannot_be_is_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
