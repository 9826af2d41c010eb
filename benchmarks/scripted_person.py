"""A scripted person teaches through the web page: no reaction before 300 ms, real time throughout.

    python benchmarks/scripted_person.py --seed 0

Starts ``recipes/haim.py mentor=browser``, opens its page in a headless Chromium and holds a
gamepad there. The person knows only what the page is told: from the scenario's number and the
actions that were executed it keeps a copy of the scene (which must agree with the page to the
centimetre), looks for danger in what the agent is doing as ``switch=delayed`` does, and drives as
``mentor=expert`` does. Taking over needs ``--reaction`` seconds from the first sign of danger on,
and what the hands do in control reaches the gamepad ``--hand`` seconds after the scene was seen;
page, connection and smoothing come on top. Needs playwright and a Chromium.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf
from tensordict import TensorDict

from haim_torchrl.evaluation.assembly import World
from haim_torchrl.evaluation.drivers import simulator_of
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import Delay, Hold, RiskSwitch
from haim_torchrl.switches.protocol import Situation

PORT = 8900
GAMEPAD = """
window.hands = {steering: 0, throttle: 0, brake: 0, takeover: false};
navigator.getGamepads = () => {
  const hands = window.hands;
  const buttons = Array.from({length: 17}, () => ({pressed: false, touched: false, value: 0}));
  buttons[0] = {pressed: hands.takeover, touched: hands.takeover, value: Number(hands.takeover)};
  buttons[6] = {pressed: hands.brake > 0, touched: false, value: hands.brake};
  buttons[7] = {pressed: hands.throttle > 0, touched: false, value: hands.throttle};
  return [{id: "scripted hands", index: 0, connected: true, mapping: "standard",
           timestamp: performance.now(), axes: [hands.steering, 0, 0, 0], buttons}];
};
"""
DEAD_ZONE = 0.05  # of conf/mentor/keyboard.yaml; a person learns to move the stick past it
FREE = {"steering": 0.0, "throttle": 0.0, "brake": 0.0, "takeover": False}


class Person:
    """Sees frames, and moves a gamepad later.

    Args:
        reaction: time from the first sign of danger to taking over [s].
        hand: time from a scene to what the hands do about it, when in control [s].
        settings: ``config.yaml`` of the run, which says what world it is.
    """

    def __init__(self, reaction: float, hand: float, settings: Path) -> None:
        self.expert = ExpertMentor()
        risk = RiskSwitch(max_lateral_acceleration=4.0, max_stalled_steps=20, release_clearance=1.5)
        self.switch = Hold(Delay(risk, round(reaction / 0.1) - 1), 5)
        self.hand = hand
        self.settings = settings
        self.simulator: Any = None
        self.nothing = TensorDict({}, [])
        self.driving = False
        self.episode, self.step = -1, 0
        self.moves: deque[tuple[float, dict[str, Any]]] = deque()
        self.apart = 0.0

    def see(self, message: dict[str, Any]) -> None:
        """Take in a scene or a frame of the page."""
        if message["type"] == "scene":
            if message["episode"] == self.episode:
                return  # told again, since the connection was cut
            self.episode = message["episode"]
            if self.simulator is None:
                config = OmegaConf.load(self.settings)
                self.simulator = simulator_of(World.of(config, "train", takeovers=False)())
            self.simulator.reset(seed=message["scenario"])
            self.expert.reset(self.simulator)
            self.switch.reset()
            self.driving, self.step = False, 0
            self._move(FREE)
        elif message["type"] == "frame" and message["step"] > self.step:
            if message["step"] != self.step + 1:
                raise RuntimeError(f"frame {self.step + 1} never came, but {message['step']}")
            self.step += 1
            self.simulator.step(np.array(message["action"], dtype=np.float32))
            here = self.simulator.snapshot().vehicle[:2]
            self.apart = max(self.apart, float(np.abs(here - message["vehicle"][:2]).max()))
            if self.apart > 0.02:
                raise RuntimeError(f"the page shows another scene, {self.apart:.2f} m away")
            self._decide(torch.tensor(message["action_agent"]))

    def _decide(self, agent: torch.Tensor) -> None:
        situation = Situation(self.simulator, self.nothing, agent, self.expert, self.driving)
        self.driving = self.switch(situation)
        if not self.driving:
            self._move(FREE)
            return
        acceleration, steering = torch.as_tensor(situation.mentor_action()).tolist()
        self._move(
            {
                "steering": _past_dead_zone(steering),
                "throttle": _past_dead_zone(max(acceleration, 0.0)),
                "brake": _past_dead_zone(max(-acceleration, 0.0)),
                "takeover": True,
            }
        )

    def _move(self, hands: dict[str, Any]) -> None:
        self.moves.append((time.monotonic() + self.hand, hands))

    def hands(self) -> dict[str, Any] | None:
        """The newest move that is due, if any."""
        due = None
        while self.moves and self.moves[0][0] <= time.monotonic():
            due = self.moves.popleft()[1]
        return due


def _past_dead_zone(value: float) -> float:
    sign = float(np.sign(value))
    return sign * (DEAD_ZONE + (1.0 - DEAD_ZONE) * abs(value))


def drive(address: str, person: Person, running: subprocess.Popen[bytes]) -> None:
    """Sit at the page until the run ends."""
    from playwright.sync_api import Error, sync_playwright

    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_context(viewport={"width": 480, "height": 360}).new_page()
        page.add_init_script(GAMEPAD)
        inbox: deque[str] = deque()
        page.on(
            "websocket",
            lambda socket: socket.on("framereceived", lambda message: inbox.append(message)),
        )
        while running.poll() is None:
            try:
                page.goto(address)
                break
            except Error:
                time.sleep(0.5)
        while running.poll() is None:
            page.wait_for_timeout(5)
            while inbox:
                person.see(json.loads(inbox.popleft()))
            hands = person.hands()
            if hands is not None:
                page.evaluate("hands => { window.hands = hands; }", hands)


def main() -> None:
    """Run, and print where the figures are."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--reaction", type=float, default=0.3)
    parser.add_argument("--hand", type=float, default=0.0)
    parser.add_argument("--folder", type=Path, default=None)
    parser.add_argument("overrides", nargs="*", help="further overrides of recipes/haim.py")
    given = parser.parse_args()
    folder = given.folder or Path("runs/scripted_person") / str(given.seed)
    port = PORT + given.seed
    command = [
        *(sys.executable, "recipes/haim.py", "mentor=browser", f"mentor.console.port={port}"),
        *(f"seed={given.seed}", f"total_frames={given.steps}", f"hydra.run.dir={folder}"),
        *("eval.show=0", "eval.pictures=false", "logger=csv", *given.overrides),
    ]
    person = Person(given.reaction, given.hand, folder / "config.yaml")
    running = subprocess.Popen(command)
    try:
        drive(f"http://127.0.0.1:{port}/", person, running)
    finally:
        if running.poll() is None:
            running.terminate()
    print(f"page and person's idea of the scene agreed to {person.apart:.3f} m")
    print(f"figures: {folder / 'metrics.json'}")
    raise SystemExit(running.wait())


if __name__ == "__main__":
    main()
