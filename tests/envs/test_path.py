"""Paths: a line and an arc by hand, and projection as the inverse of interpolation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from haim_torchrl.envs.path import Path, Piece, arc, draw, nearest

LINE = draw([Piece(20.0)], (1.0, 2.0, 0.0))
BEND = draw([arc(20.0, math.pi / 2)])  # to the right: towards +y

pieces = st.lists(
    st.one_of(
        st.floats(5.0, 60.0).map(Piece),
        st.tuples(st.floats(18.0, 70.0), st.floats(0.3, 1.5), st.sampled_from([-1, 1])).map(
            lambda t: arc(t[0], t[1] * t[2])
        ),
    ),
    min_size=1,
    max_size=4,
)


def wound_up(path: Path) -> bool:
    """Whether the path comes near to itself, so that projections have two answers."""
    gap = np.hypot(path.x[:, None] - path.x[None, :], path.y[:, None] - path.y[None, :])
    index = np.arange(len(path.x))
    return bool(((np.abs(index[:, None] - index[None, :]) > 40) & (gap < 25)).any())


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((6.0, 2.0), (5.0, 0.0)),
        ((6.3, 5.0), (5.3, 3.0)),  # to the right
        ((6.3, 1.5), (5.3, -0.5)),  # to the left
        ((-2.0, 3.0), (-3.0, 1.0)),  # before the start
        ((25.0, 1.0), (24.0, -1.0)),  # after the end
    ],
)
def test_a_line_by_hand(point: tuple[float, float], expected: tuple[float, float]) -> None:
    assert LINE.project(point) == pytest.approx(expected)
    assert LINE.at(*expected) == pytest.approx((*point, 0.0))


def test_a_right_bend_by_hand() -> None:
    assert BEND.length == 31.0  # 31.4 m, cut to whole metres
    x, y, heading = BEND.at(10.0)
    assert (x, y) == pytest.approx((20 * math.sin(0.5), 20 * (1 - math.cos(0.5))), abs=1e-3)
    assert heading == pytest.approx(0.5)
    # Four metres to the right of the path is four metres nearer to the circle's centre.
    inner = (16 * math.sin(0.5), 20 - 16 * math.cos(0.5))
    assert BEND.at(10.0, 4.0)[:2] == pytest.approx(inner, abs=1e-3)
    assert BEND.project(inner) == pytest.approx((10.0, 4.0), abs=1e-3)


def test_a_point_between_samples_of_a_bend_is_on_the_curve_and_not_on_the_tangent() -> None:
    angle = 10.5 / 20
    point = (20 * math.sin(angle), 20 * (1 - math.cos(angle)))
    assert BEND.project(point) == pytest.approx((10.5, 0.0), abs=1e-3)


def test_a_path_goes_on_straight_beyond_its_ends() -> None:
    end = BEND.at(31.0)
    x, y, heading = BEND.at(36.0)
    assert heading == end[2]
    assert math.hypot(x - end[0], y - end[1]) == pytest.approx(5.0)
    assert BEND.at(-3.0) == pytest.approx((-3.0, 0.0, 0.0))


@given(pieces, st.floats(0.0, 1.0), st.floats(-6.0, 6.0), st.floats(-3.0, 3.0))
@settings(max_examples=150, deadline=None)
def test_projection_is_the_inverse_of_interpolation(chain, share, d, heading) -> None:
    path = draw(chain, (3.0, -7.0, heading))
    assume(not wound_up(path))
    s = share * path.length
    x, y, _ = path.at(s, d)
    # Interpolation takes the chord between samples: 7 mm at the smallest radius.
    assert path.project((x, y)) == pytest.approx((s, d), abs=0.03)


@given(pieces, st.floats(-150.0, 150.0), st.floats(-150.0, 150.0))
@settings(max_examples=200, deadline=None)
def test_the_nearest_sample_is_the_one_that_looking_at_all_finds(chain, x, y) -> None:
    path = draw(chain)
    everything = (path.x - x) ** 2 + (path.y - y) ** 2
    assert nearest(x, y, path.x, path.y) == int(np.argmin(everything))


def test_samples_are_a_metre_apart() -> None:
    for path in (LINE, BEND, BEND.shifted(-4.0), draw([Piece(7.3), arc(18.0, -2.0)])):
        steps = np.hypot(np.diff(path.x), np.diff(path.y))
        assert steps.max() <= 1.0 + 1e-9
        assert steps[:-1].min() > 0.97


def test_a_shifted_bend_has_the_radius_of_its_lane() -> None:
    inner, outer = BEND.shifted(4.0), BEND.shifted(-4.0)
    assert inner.length == pytest.approx(31 * 16 / 20, abs=1.0)
    assert outer.length == pytest.approx(31 * 24 / 20, abs=1.0)
    radii = np.hypot(inner.x, inner.y - 20.0)
    assert radii == pytest.approx(np.full(len(radii), 16.0), abs=0.01)


def test_a_shift_may_change_along_the_path() -> None:
    drift = LINE.shifted(np.linspace(0.0, 2.0, len(LINE.x)))
    assert drift.y[0] == pytest.approx(2.0)
    assert LINE.project((drift.x[-1], drift.y[-1]))[1] == pytest.approx(2.0, abs=0.11)


def test_parts_and_continuations() -> None:
    part = LINE.part(4.4, 9.0)
    assert (part.x[0], part.x[-1]) == pytest.approx((5.0, 10.0))
    assert LINE.part(-5.0, 99.0).length == LINE.length
    whole = BEND.then(draw([Piece(10.0)], BEND.at(31.0)))
    assert whole.length == pytest.approx(41.0, abs=1.0)
    assert whole.at(36.0)[2] == pytest.approx(31 / 20, abs=0.01)


def test_headings_do_not_jump_in_a_full_turn() -> None:
    circle = draw([arc(20.0, -2 * math.pi)])
    ring = Path.through(circle.x, circle.y)
    assert np.abs(np.diff(ring.heading)).max() < 0.1
    assert ring.heading[-1] == pytest.approx(-ring.length / 20, abs=0.05)


def test_a_path_needs_a_metre() -> None:
    with pytest.raises(ValueError, match=r"at least 1\.0 m, got 0\.50 m"):
        Path.through(np.array([0.0, 0.5]), np.array([0.0, 0.0]))


def test_repeated_points_do_no_harm() -> None:
    path = Path.through(np.array([0.0, 0.0, 3.0, 3.0, 5.0]), np.zeros(5))
    assert path.x.tolist() == [0, 1, 2, 3, 4, 5]
    assert path.heading.tolist() == [0.0] * 6
