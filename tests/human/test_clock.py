"""A pace that is held. In a time of the tests' own, since a real one depends on the load."""

from __future__ import annotations

import math
import time

import pytest

from haim_torchrl.human import Clock

EARLY = 1e-4
"""What a system's sleep may lack by rounding [s]."""


class Time:
    """Passes only when somebody waits; whoever sleeps wakes up late by ``latency`` seconds."""

    def __init__(self, latency: float = 0.0) -> None:
        self.passed, self.latency = 5.0, latency

    def now(self) -> float:
        return self.passed

    def work(self, seconds: float) -> None:
        self.passed += seconds

    def sleep(self, seconds: float) -> None:
        assert seconds > 0.0
        self.passed += seconds + self.latency

    def clock(self, pace: float) -> Clock:
        return Clock(pace, now=self.now, sleep=self.sleep)


def test_steps_come_at_the_pace_whatever_the_work_takes() -> None:
    world = Time()
    clock = world.clock(50.0)
    assert clock.wait() is None
    steps = []
    for work in (0.0, 0.01, 0.0, 0.015, 0.02, 0.012, 0.0):
        world.work(work)
        steps.append(clock.wait())
    assert steps == pytest.approx([0.02] * 7)


def test_a_late_step_begins_a_new_grid() -> None:
    world = Time()
    clock = world.clock(40.0)
    clock.wait()
    world.work(0.1)
    late = clock.wait()
    # Running to catch up would take the next three steps in no time.
    assert [late, clock.wait(), clock.wait()] == pytest.approx([0.1, 0.025, 0.025])


@pytest.mark.parametrize(("work", "after"), [(0.108, 0.092), (0.112, 0.1)])
def test_a_step_that_is_hardly_late_keeps_the_grid(work: float, after: float) -> None:
    """Up to a tenth: the next step is then the shorter one."""
    world = Time()
    clock = world.clock(10.0)
    clock.wait()
    world.work(work)
    assert [clock.wait(), clock.wait()] == pytest.approx([work, after])


def test_a_sleep_that_takes_too_long_does_not_add_up() -> None:
    world = Time(latency=0.002)
    clock = world.clock(50.0)
    clock.wait()
    assert [clock.wait() for _ in range(4)] == pytest.approx([0.022, 0.02, 0.02, 0.02])


def test_what_lies_before_a_restart_was_no_step() -> None:
    world = Time()
    clock = world.clock(2.0)
    clock.wait()
    clock.restart()
    before = world.now()
    assert clock.wait() is None  # at once, though the next step was due in half a second
    assert world.now() == before
    assert clock.wait() == pytest.approx(0.5)


def test_in_real_time_no_step_is_too_short() -> None:
    clock, period = Clock(100.0), 0.01
    began = time.perf_counter()
    assert clock.wait() is None
    steps = [clock.wait() for _ in range(5)]
    passed = time.perf_counter() - began
    # The grid allows a step to be as much shorter as the one before was late: by a tenth.
    assert all(step is not None and step >= 0.9 * period - EARLY for step in steps)
    assert 5 * period - EARLY <= sum(filter(None, steps)) <= passed


@pytest.mark.parametrize("pace", [0.0, -10.0, math.nan])
def test_a_pace_that_is_none_is_refused(pace: float) -> None:
    with pytest.raises(ValueError, match=f"pace is {pace}: it must be positive"):
        Clock(pace)
