"""Pictures of the page that a person drives with: an expert as the agent, and a person's takeover.

Needs ``pip install haim-torchrl[browser] playwright`` and a Chromium. Writes ``page.png`` and
``page_phone.png``. Options: ``--out docs/pictures --steps 60 --seed 16``.
"""

from __future__ import annotations

import argparse
import shutil
import threading
from pathlib import Path
from typing import Any

import torch
from playwright.sync_api import Page, sync_playwright
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.envs import make_env
from haim_torchrl.human import Cockpit, HumanMentor
from haim_torchrl.human.browser import BrowserConsole
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import RequestSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform

PAGES: dict[str, dict[str, Any]] = {
    "page.png": {"viewport": {"width": 1280, "height": 720}, "color_scheme": "light"},
    "page_phone.png": {
        "viewport": {"width": 390, "height": 780},
        "color_scheme": "dark",
        "has_touch": True,
        "is_mobile": True,
    },
}


def drive(
    console: BrowserConsole, seed: int, ready: threading.Event, stop: threading.Event
) -> None:
    """Drive with the expert as the agent until told to stop; the person takes over as they like."""
    takeover = InterventionTransform(lambda: HumanMentor(console), RequestSwitch())
    cockpit = Cockpit(pace=10, total_steps=20_000)
    env = TransformedEnv(make_env(), Compose(takeover, DisturbanceTransform(), cockpit))
    env.set_seed(seed)
    expert, tensordict = ExpertMentor(), env.reset()
    simulator = env.base_env._env.unwrapped
    expert.reset(simulator)
    ready.set()
    while not stop.is_set():
        tensordict.set("action", expert.act(simulator).float())
        tensordict = step_mdp(env.step(tensordict))
        if tensordict["done"].any():
            tensordict = env.reset()
            expert.reset(simulator)
    env.close()


def take_pictures(page: Page, path: Path, steps: int, touch: bool) -> None:
    """Watch for a while, take over, and keep what the page shows then."""
    while int(page.locator("#hud").get_attribute("data-step") or 0) < steps:
        page.wait_for_timeout(50)
    if touch:
        page.evaluate(
            """() => {
                const pad = document.getElementById('pad');
                const box = pad.getBoundingClientRect();
                pad.setPointerCapture = () => {};
                pad.dispatchEvent(new PointerEvent('pointerdown', {
                    clientX: box.left + 0.36 * box.width, clientY: box.top + 20, pointerId: 1 }));
            }"""
        )
    else:
        page.keyboard.down("ArrowLeft")
        page.keyboard.down("ArrowUp")
    page.locator("#hud-takeover[data-value=true]").wait_for(state="attached")
    page.wait_for_timeout(450)
    page.screenshot(path=path)


def main() -> None:
    """Take both pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "pictures")
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--seed", type=int, default=16)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for name, settings in PAGES.items():
            console, ready, stop = BrowserConsole(port=0), threading.Event(), threading.Event()
            thread = threading.Thread(target=drive, args=(console, options.seed, ready, stop))
            thread.start()
            ready.wait()
            context = browser.new_context(**settings)
            try:
                page = context.new_page()
                page.goto(console.address)
                take_pictures(page, options.out / name, options.steps, "has_touch" in settings)
            finally:
                stop.set()
                thread.join()
                context.close()
        browser.close()


if __name__ == "__main__":
    main()
