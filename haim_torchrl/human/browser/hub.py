"""Who is connected, who drives, and what the simulator reads of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from haim_torchrl.human.browser.client import ENDED, REPLACED, Client
from haim_torchrl.human.browser.messages import Command, Input
from haim_torchrl.human.controls import RELEASED, Controls, DeviceKind, Reading

PING_EVERY = 0.5
"""Seconds between two measurements of the way to a page and back."""
PATIENCE = 5.0
"""Seconds without an answer after which a page counts as gone, and its seat as free."""
TAKEN = "Somebody else drives; you are watching."


@dataclass(frozen=True)
class _State:
    """All that the simulator's thread reads, replaced as a whole."""

    controls: Controls = RELEASED
    kind: DeviceKind = "keys"
    connected: bool = False
    heard: float = 0.0
    rtt_ms: float | None = None
    paused: bool = False
    quit: bool = False


class Hub:
    """The pages, one of which drives.

    The first page drives, the others watch. When the driver leaves, the seat is free until a
    watcher asks for it, or the driver comes back, or anybody comes while nobody is there. A page
    that connects anew while its old connection is still thought to be open replaces it.

    Only :meth:`reading` may be called from outside of the server's event loop.

    Args:
        clock: seconds, for tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.clients: list[Client] = []
        self.driver: Client | None = None
        self._last_driver = ""
        self._clock = clock
        self._state = _State(heard=clock())
        self._scene: str | None = None
        self._frame: str | None = None

    def reading(self) -> Reading:
        """What the driver does now; safe to call from every thread."""
        state = self._state
        age = max(self._clock() - state.heard, 0.0)
        latency = None
        if state.connected and state.rtt_ms is not None:
            latency = 0.5 * state.rtt_ms + 1000.0 * age
        return Reading(
            controls=state.controls,
            kind=state.kind,
            connected=state.connected,
            age=age,
            latency_ms=latency,
            paused=state.paused,
            quit=state.quit,
        )

    # What is shown.
    def publish_scene(self, text: str) -> None:
        """Send a scene to every page; it is kept for those to come."""
        self._scene, self._frame = text, None
        for client in self.clients:
            client.post_scene(text)

    def publish_frame(self, text: str) -> None:
        """Send a frame to every page; it is kept for those to come."""
        self._frame = text
        for client in self.clients:
            client.post_frame(text)

    # Who is there.
    def join(self, client: Client) -> None:
        """A page has connected: it gets its seat, the present scene and the present frame."""
        others = list(self.clients)
        self.clients.append(client)
        known = client.identity != ""
        if self.driver is not None and known and client.identity == self.driver.identity:
            self.driver.close(REPLACED, "This page was opened again elsewhere.")
            self._seat(client)
        elif self.driver is None and (
            not others or (known and client.identity == self._last_driver)
        ):
            self._seat(client)
        self._announce()
        if self._scene is not None:
            client.post_scene(self._scene)
        if self._frame is not None:
            client.post_frame(self._frame)

    def leave(self, client: Client) -> None:
        """A page has gone; if it drove, the controls are let go and the device is away."""
        if client in self.clients:
            self.clients.remove(client)
        if client is self.driver:
            self.driver = None
            self._state = replace(self._state, controls=RELEASED, connected=False, rtt_ms=None)
        self._announce()

    def ping(self) -> None:
        """Look after every page; called every :data:`PING_EVERY` seconds."""
        for client in self.clients:
            client.ping(PATIENCE)

    def end(self) -> None:
        """Tell every page that the run has ended."""
        for client in self.clients:
            client.close(ENDED, "The run has ended.")

    # What pages say.
    def receive(self, client: Client, text: str | bytes) -> None:
        """Take a message of a page; only the driver's controls and buttons count."""
        if client.closing is not None:
            return
        message = client.receive(text)
        if client is self.driver and client.rtt_ms != self._state.rtt_ms:
            self._state = replace(self._state, rtt_ms=client.rtt_ms)
        if isinstance(message, Command) and message.name == "drive":
            if self.driver is None:
                self._seat(client)
                self._announce()
            elif client is not self.driver:
                client.refuse(TAKEN)
        elif message is None:
            return
        elif client is not self.driver:
            client.refuse(TAKEN if self.driver is not None else "Nobody drives: take the seat.")
        elif isinstance(message, Input):
            self._take_input(client, message)
        elif isinstance(message, Command):
            self._take_command(message)

    def _take_input(self, client: Client, message: Input) -> None:
        if message.time < client.input_time:
            client.refuse("t runs backwards.")
            return
        client.input_time = message.time
        self._state = replace(
            self._state, controls=message.controls, kind=message.kind, heard=self._clock()
        )

    def _take_command(self, message: Command) -> None:
        if message.name == "quit":
            self._state = replace(self._state, quit=True)
        else:
            self._state = replace(self._state, paused=message.name == "pause")
            self._announce()

    def _seat(self, client: Client) -> None:
        self.driver, self._last_driver = client, client.identity
        self._state = replace(
            self._state,
            controls=RELEASED,
            connected=True,
            heard=self._clock(),
            rtt_ms=client.rtt_ms,
        )

    def _announce(self) -> None:
        for client in self.clients:
            client.post(
                type="seat",
                driving=client is self.driver,
                free=self.driver is None,
                watchers=len(self.clients) - (self.driver is not None),
                paused=self._state.paused,
            )
