"""Real time: one step every so often, and how well that was kept."""

from __future__ import annotations

import time
from collections.abc import Callable


class Clock:
    """Holds a pace.

    Steps are due on a grid of ``1 / pace`` seconds. A step that comes late starts a new grid from
    where it is: a person who has just seen the scene jump must not see it run to catch up.

    Args:
        pace: steps per second.
        now: tells the time, in s.
        sleep: waits for a time, in s.

    Raises:
        ValueError: if the pace is not positive.
    """

    def __init__(
        self,
        pace: float,
        *,
        now: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        if not pace > 0.0:
            raise ValueError(f"pace is {pace}: it must be positive, in steps per second.")
        self.period = 1.0 / pace
        self._now, self._sleep = now, sleep
        self._due: float | None = None
        self._last: float | None = None

    def wait(self) -> float | None:
        """Wait until the next step is due.

        Returns:
            Seconds since the step before; None for the first one after :meth:`restart`.
        """
        now = self._now()
        if self._due is None:
            self._due = now
        if now < self._due:
            self._sleep(self._due - now)
            now = self._now()
        self._due = (self._due if now - self._due < 0.1 * self.period else now) + self.period
        step, self._last = None if self._last is None else now - self._last, now
        return step

    def restart(self) -> None:
        """Begin anew: what lies before, such as a pause or a new episode, was no step."""
        self._due = self._last = None
