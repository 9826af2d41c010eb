"""A pace that is held. Waiting is never too short; how much too long it is depends on the load."""

from __future__ import annotations

import math
import time

import pytest

from haim_torchrl.human import Clock

EARLY = 1e-4
"""What a system's sleep may lack by rounding [s]."""


def test_steps_come_at_the_pace_whatever_the_work_takes():
    clock, period = Clock(50.0), 0.02
    began = time.perf_counter()
    assert clock.wait() is None
    steps = []
    for work in (0.0, 0.01, 0.0, 0.015, 0.0, 0.0, 0.012, 0.0, 0.0, 0.0):
        time.sleep(work)
        step = clock.wait()
        assert step is not None
        steps.append(step)
    passed = time.perf_counter() - began
    assert sum(steps) >= 10 * period - EARLY
    assert sum(steps) <= passed  # they are measured, not wished for
    # The grid allows a step to be as much shorter as the one before was late: by a tenth.
    assert min(steps) >= 0.9 * period - EARLY
    assert sorted(steps)[5] < 5 * period


def test_a_late_step_begins_a_new_grid():
    clock, period = Clock(40.0), 0.025
    clock.wait()
    time.sleep(4 * period)
    late = clock.wait()
    assert late is not None and late >= 4 * period - EARLY
    # Running to catch up would take the next three steps in no time.
    first = clock.wait()
    assert first is not None and first >= period - EARLY
    for _ in range(2):
        step = clock.wait()
        assert step is not None and step >= 0.9 * period - EARLY


def test_a_step_that_is_hardly_late_keeps_the_grid():
    """The next step is then the shorter one; a busy machine may need several attempts."""
    period, shorter = 0.1, []
    for _ in range(6):
        clock = Clock(1.0 / period)
        clock.wait()
        time.sleep(1.04 * period)
        late, after = clock.wait(), clock.wait()
        assert late is not None and after is not None
        assert late + after >= 2 * period - EARLY
        shorter.append(after < period - 1e-3)
        if shorter[-1]:
            break
    assert any(shorter)


def test_what_lies_before_a_restart_was_no_step():
    clock = Clock(2.0)
    clock.wait()
    clock.restart()
    began = time.perf_counter()
    assert clock.wait() is None  # at once, though the next step was due in half a second
    assert time.perf_counter() - began < 0.4


@pytest.mark.parametrize("pace", [0.0, -10.0, math.nan])
def test_a_pace_that_is_none_is_refused(pace):
    with pytest.raises(ValueError, match=f"pace is {pace}: it must be positive"):
        Clock(pace)
