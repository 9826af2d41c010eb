"""The console that is a web page, for a person at another machine or a phone."""

from __future__ import annotations

import secrets
import socket
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from haim_torchrl.human.browser.encoding import encode_frame, encode_scene
from haim_torchrl.human.browser.guard import Guard, is_loopback
from haim_torchrl.human.console import ConsoleError, Frame, Scene
from haim_torchrl.human.controls import Reading

if TYPE_CHECKING:
    from haim_torchrl.human.browser.server import ServerThread


class BrowserConsole:
    """A :class:`~haim_torchrl.human.Console` in a web browser.

    The server runs in a thread of the process that opens it, which is the simulator's. The first
    page that connects drives, the others watch. Steering, throttle and brake come from keys, touch,
    a gamepad or a wheel, 30 times a second and at once on each change.

    Args:
        host: address to listen at. On any other than a loopback address a token is required.
        port: port to listen at; 0 chooses a free one.
        token: what the address must hold (``?token=``); None makes one where one is required.
        origins: further origins from which the page may come, such as that of a reverse proxy
            (``"https://lab.example.org"``).

    Raises:
        ValueError: for a port that does not exist, or an empty token.
    """

    def __init__(
        self,
        host: str = "127.0.0.1",
        port: int = 8765,
        token: str | None = None,
        origins: Sequence[str] = (),
    ) -> None:
        if not 0 <= port <= 65535:
            raise ValueError(f"port is {port}: it lies in [0, 65535].")
        if token is not None and not token:
            raise ValueError("token is empty: give a long secret one, or none.")
        if isinstance(origins, str):
            raise ValueError("origins is one text: give a list.")
        self.host = host
        self.port = port
        self.origins = tuple(origins)
        self.token = token
        self._server: ServerThread | None = None
        self._bound = port

    @property
    def address(self) -> str:
        """The page's address, with the token; once open, with the port that was chosen."""
        host = _reachable_name(self.host)
        name = f"[{host}]" if ":" in host else host
        query = "" if self.token is None else f"?token={quote(self.token, safe='')}"
        return f"http://{name}:{self._bound}/{query}"

    def open(self) -> None:
        """Start the server and print the page's address.

        Raises:
            ConsoleError: if the port cannot be had, or the server's packages are missing.
        """
        if self._server is not None:
            return
        try:
            import websockets  # noqa: F401  uvicorn speaks WebSocket with it

            from haim_torchrl.human.browser.hub import Hub
            from haim_torchrl.human.browser.server import ServerThread
        except ImportError as error:
            package = (error.name or "its web server").partition(".")[0]
            raise ConsoleError(
                f"The browser console needs {package}: install haim-torchrl[browser]."
            ) from None
        if self.token is None and not is_loopback(self.host):
            self.token = secrets.token_urlsafe(16)
        listener = _listen(self.host, self.port)
        self._bound = listener.getsockname()[1]
        try:
            self._server = ServerThread(Hub(), Guard(self.host, self.token, self.origins), listener)
        except RuntimeError as error:
            raise ConsoleError(f"The browser console cannot open: {error}") from None
        print(f"Drive at {self.address}", file=sys.stderr, flush=True)

    def read(self) -> Reading:
        """What the driver does now."""
        return Reading() if self._server is None else self._server.hub.reading()

    def begin(self, scene: Scene) -> None:
        """Show a new episode to every page."""
        if self._server is not None:
            self._server.call(self._server.hub.publish_scene, encode_scene(scene))

    def show(self, frame: Frame) -> None:
        """Show a step to every page."""
        if self._server is not None:
            self._server.call(self._server.hub.publish_frame, encode_frame(frame))

    def close(self) -> None:
        """Tell the pages that the run has ended, and stop the server."""
        if self._server is not None:
            self._server.stop()
            self._server = None

    def __getstate__(self) -> dict[str, Any]:
        if self._server is not None:
            raise TypeError("an open browser console cannot be pickled: open it where it is used.")
        return dict(self.__dict__)


def _listen(host: str, port: int) -> socket.socket:
    """A bound socket.

    Raises:
        ConsoleError: if the port is in use, or the address is not of this machine.
    """
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(
            host.strip("[]"), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, kind, protocol)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(place)
            listener.listen()
        except OSError:
            listener.close()
            raise
    except OSError as error:
        raise ConsoleError(
            f"The browser console cannot listen at {host}, port {port} ({error.strerror}): choose "
            "another port, or 0 for any free one."
        ) from None
    return listener


def _reachable_name(host: str) -> str:
    """The address to type in for a host; for "all addresses" the one that leads outside."""
    if host not in ("0.0.0.0", "::", ""):
        return host
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # chooses a route; nothing is sent
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
