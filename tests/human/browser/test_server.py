"""Who may connect, who drives, and what the simulator reads, with plain clients."""

from __future__ import annotations

import json
import pickle
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.human import (
    Brake,
    Console,
    ConsoleError,
    Controls,
    Figures,
    Frame,
    HumanMentor,
    Scene,
)
from haim_torchrl.human.browser import BrowserConsole
from haim_torchrl.human.browser.client import WINDOW
from haim_torchrl.human.browser.server import MAX_CLIENTS

SCENE = Scene(3, ScenarioLabels(17, ("straight",), 2), [RoadLine(np.array([[0.0, 1], [9, 1]]))])


def frame(step: int, **entries: Any) -> Frame:
    vehicle = np.array([1.234, -2.0, 0.5, 5.0, 2.0])
    return Frame(3, step, Snapshot(0.1 * step, vehicle, 7.25, 0.0), **entries)


def address(console: BrowserConsole, query: str = "") -> str:
    page = console.address.replace("http", "ws", 1)
    base, _, token = page.partition("?")
    return f"{base}ws?{'&'.join(filter(None, (token, query)))}"


@contextmanager
def client(console: BrowserConsole, query: str = "", **options: Any) -> Iterator[ClientConnection]:
    with connect(
        address(console, query), ping_interval=None, max_queue=None, **options
    ) as connection:
        yield connection


def receive(connection: ClientConnection, kind: str) -> dict[str, Any]:
    """The next message of a kind; frames and pings before it are answered."""
    while True:
        message = json.loads(connection.recv(timeout=30.0))
        if message["type"] == kind:
            return message
        if message["type"] == "ping":
            connection.send(json.dumps({"type": "pong", "t": message["t"]}))


def send_input(connection: ClientConnection, **entries: Any) -> None:
    whole = {"steering": 0.0, "throttle": 0.0, "brake": 0.0, "takeover": False, "kind": "keys"}
    connection.send(json.dumps({"type": "input", "t": 1.0, **whole, **entries}))


def wait(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.005)


def closing(connection: ClientConnection) -> tuple[int, str]:
    """Code and reason with which the server closes."""
    with pytest.raises(ConnectionClosed):
        while True:
            connection.recv(timeout=30.0)
    return connection.close_code or 0, connection.close_reason or ""


def fetch(console: BrowserConsole, path: str = "", **headers: str) -> tuple[int, str, dict]:
    base, _, _ = console.address.partition("?")
    try:
        with urlopen(Request(base + path, headers=headers), timeout=30.0) as answer:
            return answer.status, answer.read().decode(), dict(answer.headers)
    except HTTPError as error:
        return error.code, error.read().decode(), dict(error.headers)


def refusal(console: BrowserConsole, query: str = "", **options: Any) -> tuple[int, str]:
    """Status and text with which the server refuses a WebSocket."""
    with pytest.raises(InvalidStatus) as caught, client(console, query, **options):
        pass
    response = caught.value.response
    return response.status_code, bytes(response.body or b"").decode()


def test_the_console_keeps_the_protocol_and_travels_before_it_is_open() -> None:
    console = pickle.loads(pickle.dumps(BrowserConsole(port=0)))
    assert isinstance(console, Console)
    assert not console.read().connected
    console.open()
    console.open()  # which does nothing
    try:
        with pytest.raises(TypeError, match="open browser console cannot be pickled"):
            pickle.dumps(console)
        assert fetch(console)[0] == 200
    finally:
        console.close()
        console.close()


def test_reading_says_what_the_driver_does(console: BrowserConsole) -> None:
    assert not console.read().connected
    with client(console) as driver:
        assert receive(driver, "seat") == {
            "type": "seat", "driving": True, "free": False, "watchers": 0, "paused": False,
        }  # fmt: skip
        reading = console.read()
        assert reading.connected and reading.controls == Controls() and reading.latency_ms is None
        send_input(driver, steering=-0.5, throttle=0.25, takeover=True, kind="wheel")
        wait(lambda: console.read().controls.takeover)
        reading = console.read()
        assert reading.controls == Controls(-0.5, 0.25, 0.0, True) and reading.kind == "wheel"
        assert reading.age < 1.0
        age = console.read().age
        time.sleep(0.05)
        assert console.read().age >= age + 0.05  # nothing was heard meanwhile
        receive(driver, "ping")
        time.sleep(0.1)
        driver.send('{"type":"pong","t":1}')
        wait(lambda: console.read().latency_ms is not None)
        # Half of the time there and back, and the age of the last input.
        reading = console.read()
        assert (reading.latency_ms or 0.0) >= 50.0 + 1000.0 * reading.age
    wait(lambda: not console.read().connected)
    reading = console.read()
    assert reading.controls == Controls() and reading.latency_ms is None


def test_buttons_are_read(console: BrowserConsole) -> None:
    with client(console) as driver:
        driver.send('{"type":"pause"}')
        wait(lambda: console.read().paused)
        assert not receive(driver, "seat")["paused"] and receive(driver, "seat")["paused"]
        driver.send('{"type":"resume"}')
        wait(lambda: not console.read().paused)
        assert not console.read().quit
        driver.send('{"type":"quit"}')
        wait(lambda: console.read().quit)


def test_a_page_gets_the_present_scene_and_frame_at_once_with_all_digits(
    console: BrowserConsole,
) -> None:
    third = 1.0 / 3.0
    console.begin(SCENE)
    console.show(frame(0))
    shown = frame(
        1,
        driver="person",
        action=(third, -third),
        action_agent=(0.1, 0.2),
        action_mentor=(third, -third),
        takeover=True,
        takeover_cost=0.1 + 0.2,
        latency_ms=None,
        figures=Figures(steps=5, total_steps=9, seconds_left=float("nan"), takeover_rate=0.2),
        notice="paused",
        hint="look",
    )
    console.show(shown)
    with client(console) as page:
        scene, newest = receive(page, "scene"), receive(page, "frame")
    assert scene == {
        "type": "scene", "episode": 3, "scenario": 17, "blocks": ["straight"], "obstacles": 2,
        "road": [{"kind": "edge", "points": [[0.0, 1.0], [9.0, 1.0]]}],
    }  # fmt: skip
    assert newest["step"] == 1 and newest["episode"] == 3
    assert newest["action"] == newest["action_mentor"] == [third, -third]
    assert newest["action_agent"] == [0.1, 0.2] and newest["takeover_cost"] == 0.1 + 0.2
    assert newest["vehicle"] == [1.23, -2.0, 0.5, 5.0, 2.0] and newest["speed"] == 7.25
    assert newest["seconds_left"] is None and newest["latency_ms"] is None
    assert newest["notice"] == "paused" and newest["hint"] == "look" and newest["steps"] == 5


def test_a_page_that_keeps_up_gets_every_frame_and_a_slow_one_the_newest(
    console: BrowserConsole,
) -> None:
    console.begin(SCENE)
    console.show(frame(0))
    with client(console) as quick, client(console) as slow:
        assert receive(quick, "frame")["step"] == receive(slow, "frame")["step"] == 0
        quick.send('{"type":"seen","n":1}')
        for step in range(1, 51):
            console.show(frame(step))
            assert receive(quick, "frame")["step"] == step
            quick.send(json.dumps({"type": "seen", "n": step + 1}))
        # The slow one confirmed nothing, so only the first few are on their way to it.
        assert [receive(slow, "frame")["step"] for _ in range(WINDOW - 1)] == [*range(1, WINDOW)]
        slow.send(json.dumps({"type": "seen", "n": WINDOW}))
        assert receive(slow, "frame")["step"] == 50


def test_one_drives_and_the_others_watch_until_the_seat_is_free(console: BrowserConsole) -> None:
    with client(console, "client=b") as watcher:
        pass  # the first one has gone again
    wait(lambda: not console.read().connected)
    with client(console, "client=a") as driver, client(console, "client=b") as watcher:
        assert receive(driver, "seat")["driving"]
        assert receive(watcher, "seat") == {
            "type": "seat", "driving": False, "free": False, "watchers": 1, "paused": False,
        }  # fmt: skip
        send_input(driver, throttle=0.5)
        send_input(watcher, throttle=1.0)
        assert receive(watcher, "refused")["reason"].startswith("Somebody else drives")
        for name in ("pause", "quit", "drive"):
            watcher.send(json.dumps({"type": name}))
            assert receive(watcher, "refused")["reason"].startswith("Somebody else drives")
        reading = console.read()
        assert reading.controls.throttle == 0.5 and not reading.paused and not reading.quit
        driver.close()
        seat = receive(watcher, "seat")
        assert seat["free"] and not seat["driving"] and not console.read().connected
        send_input(watcher, throttle=1.0)
        assert receive(watcher, "refused")["reason"] == "Nobody drives: take the seat."
        watcher.send('{"type":"drive"}')
        assert receive(watcher, "seat")["driving"] and console.read().connected
        assert console.read().controls == Controls()  # the old driver's have gone with them
        with client(console, "client=a") as late:
            assert not receive(late, "seat")["driving"]


def test_the_driver_who_comes_back_drives_before_those_who_watch(console: BrowserConsole) -> None:
    with client(console, "client=a") as driver, client(console, "client=b") as watcher:
        receive(watcher, "seat")
        driver.close()
        assert receive(watcher, "seat")["free"]
        with client(console, "client=a") as again:
            assert receive(again, "seat")["driving"] and console.read().connected


def test_a_page_that_connects_anew_replaces_its_old_connection(console: BrowserConsole) -> None:
    with client(console, "client=a") as old:
        send_input(old, throttle=1.0, t=5000.0)
        wait(lambda: console.read().controls.throttle == 1.0)
        with client(console, "client=a") as new:
            assert receive(new, "seat")["driving"]
            assert console.read().controls == Controls()
            assert closing(old) == (4001, "This page was opened again elsewhere.")
            send_input(new, brake=1.0, t=1.0)
            wait(lambda: console.read().controls.brake == 1.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"type":"input"}', "A message of type input has"),
        ("hello", "This is no JSON."),
        (b"\x00", "Messages are text, not bytes."),
        ('{"type":"seen","n":99}', "So many frames were not sent."),
    ],
)
def test_what_is_refused_is_not_used_and_said(
    console: BrowserConsole, text: str | bytes, reason: str
) -> None:
    with client(console) as driver:
        send_input(driver, steering=0.5)
        driver.send(text)
        assert receive(driver, "refused")["reason"].startswith(reason)
        assert console.read().controls == Controls(steering=0.5)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), 1.5, "1"])
def test_a_value_out_of_range_steers_nothing(console: BrowserConsole, bad: Any) -> None:
    with client(console) as driver:
        send_input(driver, steering=0.5)
        send_input(driver, steering=bad, throttle=1.0)
        assert receive(driver, "refused")["reason"].endswith(".")
        assert console.read().controls == Controls(steering=0.5)
        send_input(driver, steering=0.75)
        wait(lambda: console.read().controls == Controls(steering=0.75))
        send_input(driver, steering=0.25, t=0.5)
        assert receive(driver, "refused")["reason"] == "t runs backwards."
        assert console.read().controls == Controls(steering=0.75)


def test_a_page_that_keeps_sending_nonsense_is_closed(console: BrowserConsole) -> None:
    with client(console) as driver:
        send_input(driver, throttle=1.0)
        for _ in range(11):
            driver.send("nonsense")
        code, reason = closing(driver)
    assert code == 4007 and reason == "Too many bad messages; the last: This is no JSON."
    wait(lambda: not console.read().connected)
    assert console.read().controls == Controls()


def test_a_page_that_floods_is_closed(console: BrowserConsole) -> None:
    with client(console) as driver:
        with pytest.raises(ConnectionClosed):
            for _ in range(5000):
                send_input(driver, throttle=1.0)
        assert closing(driver) == (4008, "More than 200 messages a second.")
    wait(lambda: not console.read().connected)
    assert console.read().controls == Controls()


def test_a_driver_who_falls_silent_during_a_takeover_is_not_waited_for(
    console: BrowserConsole,
) -> None:
    mentor, agent = HumanMentor(console, Brake(-0.5), stale_after=0.3), torch.zeros(2)
    with client(console) as driver:
        send_input(driver, throttle=1.0)
        wait(lambda: console.read().controls.throttle == 1.0)
        assert mentor.requests_control(None, agent) and not mentor.falling_back
        time.sleep(0.4)  # connected still, but nothing comes
        assert console.read().connected
        assert mentor.requests_control(None, agent) and mentor.falling_back
        assert mentor.act(None, TensorDict()).tolist() == [-0.5, 0.0]
        send_input(driver, t=2.0)
        wait(lambda: console.read().controls == Controls())
        mentor.requests_control(None, agent)
        assert mentor.device_ok and not mentor.falling_back


def test_there_is_room_for_so_many(console: BrowserConsole) -> None:
    with ExitStack() as stack:
        for _ in range(MAX_CLIENTS):
            receive(stack.enter_context(client(console)), "seat")
        assert refusal(console) == (503, "16 pages are open already.")
    wait(lambda: not console.read().connected)
    with client(console) as driver:
        assert receive(driver, "seat")


def test_a_message_that_is_too_long_closes_the_connection(console: BrowserConsole) -> None:
    with client(console) as driver:
        driver.send(" " * 5000)
        assert closing(driver)[0] == 1009
    wait(lambda: not console.read().connected)


def test_there_is_a_token_where_others_can_reach(capsys: pytest.CaptureFixture[str]) -> None:
    console = BrowserConsole("0.0.0.0", port=0)
    console.open()
    try:
        assert console.token is not None and len(console.token) >= 20
        assert console.address.endswith(f"/?token={console.token}")
        printed = capsys.readouterr().err
        assert printed.count(console.address) == 1
        assert fetch(console)[0] == 403
        assert fetch(console, f"?token={console.token}")[0] == 200
        with client(console) as driver:
            assert receive(driver, "seat")["driving"]
    finally:
        console.close()


def test_a_wrong_token_is_refused_with_a_reason() -> None:
    console = BrowserConsole(port=0, token="a secret/with signs")
    console.open()
    try:
        assert console.address.endswith("/?token=a%20secret%2Fwith%20signs")
        with client(console) as driver:
            assert receive(driver, "seat")["driving"]
        right, console.token = console.token, "wrong"
        wrong = "The token is wrong: open the address that the terminal shows."
        assert refusal(console) == (403, wrong)
        assert fetch(console, "?token=wrong")[:2] == (403, wrong)
        console.token = None
        missing = "The token is missing: open the address that the terminal shows."
        assert refusal(console) == (403, missing) and fetch(console)[:2] == (403, missing)
        console.token = right
    finally:
        console.close()


def test_pages_from_elsewhere_may_not_connect() -> None:
    console = BrowserConsole(port=0, origins=["https://lab.example.org"])
    console.open()
    try:
        port = console.address.split(":")[-1].strip("/")
        for origin in (
            "http://evil.example",
            "null",
            f"http://localhost:{port}",
            "http://127.0.0.1",
        ):
            assert refusal(console, origin=origin) == (
                403,
                f"Pages of {origin} may not connect here.",
            )
        for origin in (f"http://127.0.0.1:{port}", "https://lab.example.org"):
            with client(console, origin=origin) as page:
                receive(page, "seat")
    finally:
        console.close()


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost:1234", 200),  # as through a tunnel
        ("[::1]:80", 200),
        ("lab.example.org", 200),
        ("evil.example", 403),
        ("127.0.0.1.evil.example:80", 403),
        ("[oops", 403),
    ],
)
def test_names_that_lead_here_from_elsewhere_are_refused(host: str, status: int) -> None:
    console = BrowserConsole(port=0, origins=["https://lab.example.org"])
    console.open()
    try:
        for path in ("", "main.js"):
            assert fetch(console, path, Host=host)[0] == status
    finally:
        console.close()


def test_every_answer_forbids_what_is_not_needed(console: BrowserConsole) -> None:
    for path, status in (("", 200), ("style.css", 200), ("main.js", 200), ("..%2fserver.py", 404)):
        got, _, headers = fetch(console, path)
        assert got == status
        assert headers["content-security-policy"].startswith("default-src 'self'")
        assert headers["cache-control"] == "no-store"
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
    assert "http" not in fetch(console)[1].replace("http-equiv", "")  # nothing from elsewhere


def test_a_port_in_use_is_said_in_one_sentence(console: BrowserConsole) -> None:
    port = int(console.address.split(":")[-1].strip("/"))
    with pytest.raises(ConsoleError, match=rf"127.0.0.1, port {port} \(Address already in use\)"):
        BrowserConsole(port=port).open()
    with pytest.raises(ConsoleError, match=r"203\.0\.113\.1, port 8765"):
        BrowserConsole("203.0.113.1").open()  # nobody's address


@pytest.mark.parametrize("package", ["starlette", "uvicorn", "websockets"])
def test_what_is_missing_is_said_in_one_sentence(
    monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    monkeypatch.delitem(sys.modules, "haim_torchrl.human.browser.server", raising=False)
    for name in list(sys.modules):
        if name.partition(".")[0] == package:
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConsoleError) as caught:
        BrowserConsole(port=0).open()
    assert str(caught.value) == (
        f"The browser console needs {package}: install haim-torchrl[browser]."
    )


@pytest.mark.parametrize("options", [{"port": 70000}, {"token": ""}, {"origins": "http://a"}])
def test_settings_that_cannot_be(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        BrowserConsole(**options)


def test_the_end_is_said_and_the_port_is_free_at_once(console: BrowserConsole) -> None:
    port = int(console.address.split(":")[-1].strip("/"))
    with client(console) as driver:
        receive(driver, "seat")
        begin = time.monotonic()
        console.close()
        assert time.monotonic() - begin < 2.0
        assert closing(driver) == (1001, "The run has ended.")
    assert not console.read().connected
    with pytest.raises(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
        pass
    again = BrowserConsole(port=port)
    again.open()
    try:
        with client(again) as driver:
            assert receive(driver, "seat")["driving"]
            assert not again.read().quit
    finally:
        again.close()


def test_a_page_that_does_not_close_is_no_reason_to_wait(console: BrowserConsole) -> None:
    port = int(console.address.split(":")[-1].strip("/"))
    with socket.create_connection(("127.0.0.1", port)) as mute:
        mute.sendall(
            f"GET /ws HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n".encode()
        )
        wait(lambda: console.read().connected)
        begin = time.monotonic()
        console.close()
        assert time.monotonic() - begin < 3.0
