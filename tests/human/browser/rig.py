"""A run that a person drives in a browser: the environment steps in a thread of its own."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.data import Session, read_session
from haim_torchrl.envs import make_env
from haim_torchrl.human import Brake, Cockpit, HumanMentor, Pause, PersonQuit, Reading
from haim_torchrl.human.browser import BrowserConsole
from haim_torchrl.switches import RequestSwitch
from haim_torchrl.transforms import (
    DisturbanceTransform,
    InterventionTransform,
    SessionRecorder,
)

ROAD = {
    "blocks": {"straight": 1.0},
    "traffic_density": 0.0,
    "side_traffic": 0.0,
    "obstacles": (1.0,),
    "lanes": (3,),
}
AGENT = [0.1, 0.05]  # speeds up gently, to the right
OBSERVER = """
new MutationObserver(() => {
  const hud = document.getElementById("hud");
  if (hud === null || hud.dataset.step === "") return;
  const shown = { episode: Number(hud.dataset.episode), step: Number(hud.dataset.step) };
  shown.driver = hud.dataset.driver;
  shown.notice = hud.dataset.notice;
  document.querySelectorAll("#hud [id^=hud-]").forEach((place) => {
    shown[place.id.slice(4)] = place.textContent;
    shown[`${place.id.slice(4)} value`] = place.dataset.value;
  });
  (window.shown ??= []).push(shown);
}).observe(document, { subtree: true, attributeFilter: ["data-step"] });
"""
"""Keeps what the page shows of each step, for the test to read."""


class _Console(BrowserConsole):
    """A console that can be left from outside, too, also while the run is on hold."""

    leaving = False

    def read(self) -> Reading:
        reading = super().read()
        return replace(reading, quit=reading.quit or self.leaving)


class Relay:
    """A line between browser and simulator that can be cut and mended."""

    def __init__(self, port: int) -> None:
        self._goal = port
        self._ends: list[socket.socket] = []
        self._whole = True
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"http://127.0.0.1:{self._listener.getsockname()[1]}/"
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Break every connection off, and let nobody connect."""
        self._whole = False
        while self._ends:
            with suppress(OSError):
                self._ends.pop().shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        """Let pages connect again."""
        self._whole = True

    def close(self) -> None:
        """End it all."""
        self.cut()
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                if not self._whole:
                    near.close()
                    continue
                far = socket.create_connection(("127.0.0.1", self._goal))
                self._ends += [near, far]
                for source, sink in ((near, far), (far, near)):
                    threading.Thread(target=_pass_on, args=(source, sink), daemon=True).start()


def _pass_on(source: socket.socket, sink: socket.socket) -> None:
    with suppress(OSError):
        while data := source.recv(65536):
            sink.sendall(data)
    for end in (source, sink):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
    source.close()


class Run:
    """The real environment with a person at the page, stepping until it is stopped.

    The watchdog is patient, since a busy machine may keep the browser waiting; a connection that is
    gone it sees at once all the same.

    Attributes:
        steps: what each step returned, with the numbers of its episode and of the step in it.
        ended: why it ended by itself.
    """

    def __init__(
        self,
        folder: Path,
        *,
        pace: float = 20.0,
        fallback: Brake | Pause | None = None,
        stale_after: float = 6.0,
    ) -> None:
        self.console = _Console(port=0)
        self.file = folder / "session.jsonl"
        self.steps: list[dict[str, Any]] = []
        self.ended: BaseException | None = None
        self._stop = threading.Event()
        takeover = InterventionTransform(
            lambda: HumanMentor(
                self.console, fallback, stale_after=stale_after, absent_after=8.0, settle=0.1
            ),
            RequestSwitch(),
        )
        cockpit = Cockpit(pace=pace, total_steps=5000)
        self._env = TransformedEnv(
            make_env(scenario=ROAD, horizon=100_000, initial_speed=2.0),
            Compose(takeover, DisturbanceTransform(), SessionRecorder(self.file), cockpit),
        )
        self._env.set_seed(0)
        self._thread = threading.Thread(target=self._drive, daemon=True)
        self._open = threading.Event()

    def start(self) -> Run:
        """Begin to drive; returns when the page can be loaded."""
        self._thread.start()
        assert self._open.wait(30.0)
        self.relay = Relay(int(self.console.address.split(":")[-1].strip("/")))
        return self

    def stop(self) -> None:
        """Stop driving and close everything, also while the run is on hold."""
        self._stop.set()
        self.console.leaving = True
        if self._thread.is_alive():
            self._thread.join(10.0)
        self._env.close()
        self.relay.close()

    def session(self) -> Session:
        """The session file, once the run has stopped."""
        return read_session(self.file)

    def wait(self, condition: Callable[[], Any], seconds: float = 10.0) -> None:
        """Wait until something has happened."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"not in time; the last step: {self.steps[-1:]}"
            time.sleep(0.01)

    def wait_steps(self, count: int) -> None:
        """Wait for so many further steps."""
        goal = len(self.steps) + count
        self.wait(lambda: len(self.steps) >= goal)

    def _drive(self) -> None:
        torch.set_num_threads(1)
        try:
            tensordict, episode = self._env.reset(), 0
            self._open.set()
            step = 0
            while not self._stop.is_set():
                tensordict["action"] = torch.tensor(AGENT)
                after = self._env.step(tensordict)["next"]
                step += 1
                entries = {key: value.tolist() for key, value in after.items()}
                self.steps.append(entries | {"episode": episode, "step": step})
                tensordict = step_mdp(tensordict)
                if after["done"].any():
                    tensordict, episode, step = self._env.reset(), episode + 1, 0
        except PersonQuit as error:
            self.ended = error
        finally:
            self._open.set()
