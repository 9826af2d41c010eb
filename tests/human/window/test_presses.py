"""Keys and buttons over time: nothing is lost, nothing sticks."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.human.window.presses import MEMORY, Presses


def test_a_tap_between_two_looks_counts_in_one_step_however_often_it_is_looked_at() -> None:
    presses = Presses()
    presses.press(1)
    presses.release(1)
    assert presses.look(0.0) == {1} and presses.look(0.05) == {1}
    presses.shown()
    assert presses.look(0.1) == set()


def test_a_tap_after_the_last_look_waits_for_the_next_step() -> None:
    presses = Presses()
    presses.look(0.0)
    presses.press(1)
    presses.release(1)
    presses.shown()
    assert presses.look(0.1) == {1}


def test_a_tap_is_forgotten_where_no_step_is_shown() -> None:
    presses = Presses()
    presses.press(1)
    presses.release(1)
    assert presses.look(0.0) == {1}
    assert presses.look(MEMORY) == {1}
    assert presses.look(MEMORY + 0.01) == set()


def test_the_state_of_the_system_corrects_a_lost_release() -> None:
    presses = Presses()
    presses.press(1)
    presses.agree({1})
    presses.look(0.0)
    presses.shown()
    presses.agree(set())
    assert presses.look(0.1) == set()


@settings(deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3)), max_size=30))
def test_after_a_step_exactly_what_is_down_is_held(events: list[tuple[bool, int]]) -> None:
    presses, down, touched = Presses(), set(), set()
    for pressed, code in events:
        if pressed:
            presses.press(code)
            down.add(code)
            touched.add(code)
        else:
            presses.release(code)
            down.discard(code)
    assert presses.look(0.0) == touched
    presses.shown()
    assert presses.look(0.1) == down
    presses.release_all()
    assert presses.look(0.2) == set()
