"""One connected page: what waits to be sent to it, and how well it behaves."""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from haim_torchrl.human.browser.messages import Message, Pong, Refusal, Seen, parse

WINDOW = 10
"""Frames that may be on their way to a page; one that is further behind gets the newest only."""
MAX_RATE = 200.0
"""Messages a second that a page may send."""
MAX_REFUSALS = 10
"""Malformed messages after which a page is closed."""
MAX_WAITING = 64
"""Messages other than frames that may wait for a page that reads nothing."""

FLOODED, MALFORMED, SILENT, REPLACED, ENDED = 4008, 4007, 4009, 4001, 1001
"""Close codes."""


class Client:
    """A connected page. Everything here happens in the server's event loop.

    Args:
        identity: the page's own secret name, by which a page that comes back is known; "" if it
            has none.
        clock: seconds, for tests.
    """

    def __init__(self, identity: str = "", clock: Callable[[], float] = time.monotonic) -> None:
        self.identity = identity
        self.rtt_ms: float | None = None
        """Time of the last ping and its answer [ms]."""
        self.input_time = 0.0
        """The page's clock at its last input [ms]."""
        self.closing: tuple[int, str] | None = None
        """Close code and reason, once the page is to go."""
        self._clock = clock
        self._waiting: deque[tuple[str, str]] = deque()
        self._wake = asyncio.Event()
        self._sent = self._seen = 0
        self._credit, self._credited = MAX_RATE, clock()
        self._refusals = 0
        self._pings: dict[int, float] = {}
        self._ping = 0
        self._answered = clock()

    # To the page.
    def post(self, **entries: Any) -> None:
        """Send a short message soon."""
        if len(self._waiting) >= MAX_WAITING:
            self.close(SILENT, "This page did not read its messages.")
            return
        self._put("note", json.dumps(entries, separators=(",", ":")))

    def post_scene(self, text: str) -> None:
        """Send a scene soon."""
        if self._is_behind():
            self._drop("frame", "scene")
        self._put("scene", text)

    def post_frame(self, text: str) -> None:
        """Send a frame soon; to a page that is behind, only the newest."""
        if self._is_behind():
            self._drop("frame")
        self._put("frame", text)

    def ping(self, patience: float) -> None:
        """Measure the way to the page and back; close one that has been silent for too long.

        Args:
            patience: longest time without an answer [s].
        """
        now = self._clock()
        if now - self._answered > patience:
            self.close(SILENT, "This page did not answer any more.")
            return
        self._ping += 1
        self._pings[self._ping] = now
        self.post(type="ping", t=self._ping)

    def refuse(self, reason: str) -> None:
        """Tell the page that its message was not used."""
        self.post(type="refused", reason=reason)

    def close(self, code: int, reason: str) -> None:
        """Let the page go; the first reason counts."""
        if self.closing is None:
            self.closing = (code, reason)
            self._wake.set()

    async def next(self) -> str | None:
        """The next message to send; None once the page is to be closed."""
        while self.closing is None:
            for place, (kind, text) in enumerate(self._waiting):
                if kind != "frame":
                    del self._waiting[place]
                    return text
                if self._sent - self._seen < WINDOW:
                    del self._waiting[place]
                    self._sent += 1
                    return text
                break
            self._wake.clear()
            await self._wake.wait()
        return None

    # From the page.
    def receive(self, text: str | bytes) -> Message | None:
        """The message in a text; None if it is refused, or was for this connection alone."""
        if not self._may_send():
            self.close(FLOODED, f"More than {MAX_RATE:.0f} messages a second.")
            return None
        message = parse(text)
        if isinstance(message, Seen) and not self._seen <= message.count <= self._sent:
            message = Refusal("So many frames were not sent.")
        if isinstance(message, Refusal):
            self._refusals += 1
            self.refuse(message.reason)
            if self._refusals > MAX_REFUSALS:
                self.close(MALFORMED, f"Too many bad messages; the last: {message.reason}"[:120])
            return None
        if isinstance(message, Seen):
            self._seen = message.count
            self._wake.set()
            return None
        if isinstance(message, Pong):
            self._take_pong(message.number)
            return None
        return message

    def _take_pong(self, number: int) -> None:
        sent = self._pings.pop(number, None)
        if sent is not None:
            self._answered = self._clock()
            self.rtt_ms = 1000.0 * (self._answered - sent)
            self._pings = {n: t for n, t in self._pings.items() if n > number}

    def _may_send(self) -> bool:
        """Whether the page keeps to the rate: a bucket that a second fills."""
        now = self._clock()
        self._credit = min(MAX_RATE, self._credit + MAX_RATE * (now - self._credited))
        self._credited = now
        self._credit -= 1.0
        return self._credit >= 0.0

    def _is_behind(self) -> bool:
        waiting = sum(kind == "frame" for kind, _ in self._waiting)
        return self._sent - self._seen + waiting >= WINDOW

    def _drop(self, *kinds: str) -> None:
        self._waiting = deque(entry for entry in self._waiting if entry[0] not in kinds)

    def _put(self, kind: str, text: str) -> None:
        self._waiting.append((kind, text))
        self._wake.set()
