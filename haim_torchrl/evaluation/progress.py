"""The live line of a long job: rewritten in place on a terminal, now and then a line elsewhere."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from types import TracebackType
from typing import TextIO


def clock(seconds: float) -> str:
    """Seconds as ``m:ss`` or ``h:mm:ss``; ``-:--`` when unknown.

    Example:
        >>> clock(75), clock(3661), clock(float("nan"))
        ('1:15', '1:01:01', '-:--')
    """
    if not math.isfinite(seconds):
        return "-:--"
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class ProgressLine:
    """Steps, speed, figures and the time left, on one line.

    Args:
        total: Steps of the whole job.
        start: Steps done before, by the run that this one resumes.
        unit: What a step is called.
        label: Stands before each line, of which there are then few, since several jobs write them.
        every: Seconds between lines where there is no terminal; on a terminal ten a second at most.
        stream: Where to write.
        enabled: False writes nothing.

    Example:
        >>> with ProgressLine(100, enabled=False) as line:
        ...     line.update(50, takeover=0.3)
    """

    def __init__(
        self,
        total: int,
        start: int = 0,
        *,
        unit: str = "steps",
        label: str = "",
        every: float = 15.0,
        stream: TextIO | None = None,
        enabled: bool = True,
    ) -> None:
        self.total, self._first, self.unit = total, start, unit
        self._stream = stream or sys.stdout
        self._label = f"{label}: " if label else ""
        self._live = not label and bool(getattr(self._stream, "isatty", lambda: False)())
        self._every = 0.1 if self._live else 4 * every if label else every
        self._enabled = enabled
        self._began = self._shown = time.monotonic()
        self._width = 0

    def __enter__(self) -> ProgressLine:
        """Start the clock."""
        self._began = self._shown = time.monotonic()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the last line standing."""
        if self._enabled and self._live and self._width:
            self._stream.write("\n")
            self._stream.flush()

    def text(self, steps: int, figures: Mapping[str, float | str]) -> str:
        """The line for ``steps`` done, with the figures as given."""
        elapsed = time.monotonic() - self._began
        done = steps - self._first
        speed = done / elapsed if elapsed > 0.0 and done > 0 else math.nan
        left = (self.total - steps) / speed if speed == speed else math.nan
        parts = [f"{steps}/{self.total} {self.unit}"]
        if speed == speed:
            parts.append(f"{speed:.1f}/s")
        for name, value in figures.items():
            shown = value if isinstance(value, str) else f"{value:.3g}"
            parts.append(f"{name.replace('_', ' ')} {'-' if shown == 'nan' else shown}")
        parts.append(f"{clock(left)} left")
        return "  ".join(parts)

    def update(self, steps: int, **figures: float | str) -> None:
        """Show the state if it is time to, or if this was the last step."""
        now = time.monotonic()
        if not self._enabled or (now - self._shown < self._every and steps < self.total):
            return
        self._shown = now
        line = self.text(steps, figures)
        if self._live:
            self._stream.write("\r" + line.ljust(self._width))
            self._width = len(line)
        else:
            self._stream.write(f"{self._label}{line}\n")
        self._stream.flush()

    def note(self, message: str) -> None:
        """Print a line of its own without disturbing the live one."""
        if not self._enabled:
            return
        if self._live and self._width:
            self._stream.write("\r" + " " * self._width + "\r")
            self._width = 0
        self._stream.write(f"{self._label}{message}\n")
        self._stream.flush()
