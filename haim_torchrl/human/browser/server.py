"""The web server: the page's files and its WebSocket, in a thread of the simulator's process."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from importlib import resources
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from haim_torchrl.human.browser.client import Client
from haim_torchrl.human.browser.guard import HEADERS, Guard
from haim_torchrl.human.browser.hub import PING_EVERY, Hub
from haim_torchrl.human.browser.messages import MAX_BYTES

MAX_CLIENTS = 16
"""Pages that may be connected at once."""
_MEDIA = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}


def make_app(hub: Hub, guard: Guard) -> Starlette:
    """The ASGI application: ``/``, the page's files, and ``/ws``."""
    folder = resources.files(__package__).joinpath("page")
    files = {file.name: file.read_bytes() for file in folder.iterdir() if file.is_file()}

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        why = guard.refuse(request.headers, request.query_params, secret=name == "index.html")
        if why is not None:
            return PlainTextResponse(why, 403, HEADERS)
        media = _MEDIA.get(name[name.rfind(".") :])
        if name not in files or media is None:
            return PlainTextResponse("There is no such page.", 404, HEADERS)
        return Response(files[name], headers=HEADERS, media_type=media)

    async def talk(websocket: WebSocket) -> None:
        why, status = guard.refuse(websocket.headers, websocket.query_params), 403
        if why is None and len(hub.clients) >= MAX_CLIENTS:
            why, status = f"{MAX_CLIENTS} pages are open already.", 503
        if why is not None:
            await websocket.send_denial_response(PlainTextResponse(why, status, HEADERS))
            return
        await websocket.accept()
        await _serve(websocket, hub, Client(_identity(websocket)))

    return Starlette(
        routes=[
            Route("/", page),
            WebSocketRoute("/ws", talk),
            Route("/{name:path}", page),
        ]
    )


def _identity(connection: HTTPConnection) -> str:
    return connection.query_params.get("client", "")[:64]


async def _serve(websocket: WebSocket, hub: Hub, client: Client) -> None:
    """Talk to a page until it goes, or is to go."""

    async def send() -> None:
        while (text := await client.next()) is not None:
            await websocket.send_text(text)

    async def receive() -> None:
        while client.closing is None:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            hub.receive(client, message.get("bytes", b"") if text is None else text)

    hub.join(client)
    tasks = [asyncio.create_task(send()), asyncio.create_task(receive())]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        hub.leave(client)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    if client.closing is not None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await websocket.close(*client.closing)


class ServerThread:
    """Serves the page from a thread with an event loop of its own.

    Args:
        hub: who drives and what is shown.
        guard: who may connect.
        listener: bound socket; it is closed with the server.

    Raises:
        RuntimeError: if the server does not start.
    """

    def __init__(self, hub: Hub, guard: Guard, listener: socket.socket) -> None:
        self.hub = hub
        self._listener = listener
        self._server = uvicorn.Server(
            uvicorn.Config(
                make_app(hub, guard),
                log_config=None,
                log_level="critical",
                access_log=False,  # addresses hold the token
                lifespan="off",
                server_header=False,
                proxy_headers=False,
                ws_max_size=MAX_BYTES,
                ws_per_message_deflate=False,
                ws_ping_interval=None,  # the hub has a ping of its own
                limit_concurrency=4 * MAX_CLIENTS,
                timeout_graceful_shutdown=1,
            )
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="browser console", daemon=True)
        self._thread.start()
        if not self._ready.wait(10.0) or not self._thread.is_alive():
            raise RuntimeError("the web server did not start.")

    def call(self, function: Any, *args: Any) -> None:
        """Call a function in the event loop, soon; nothing happens once the server has stopped."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(function, *args)

    def stop(self, patience: float = 5.0) -> None:
        """Say goodbye to every page and stop; returns when the port is free."""
        self.call(self._end)
        self._thread.join(patience)

    def _end(self) -> None:
        self.hub.end()
        self._server.should_exit = True

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        finally:
            self._listener.close()
            self._ready.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        care = asyncio.create_task(self._care())
        try:
            await self._server.serve(sockets=[self._listener])
        finally:
            care.cancel()

    async def _care(self) -> None:
        while True:
            if self._server.started:
                self._ready.set()
            await asyncio.sleep(PING_EVERY if self._ready.is_set() else 0.01)
            self.hub.ping()
