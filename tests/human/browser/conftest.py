"""A console, and a browser to drive with."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from haim_torchrl.human.browser import BrowserConsole

from .rig import OBSERVER, Run

EXPECTED = ("WebSocket connection", "ERR_", "403 (Forbidden)", "getImageData")
"""What a browser says of lines that are cut, tokens that are wrong, and pixels that are read."""


@pytest.fixture
def console() -> Iterator[BrowserConsole]:
    """An open console at a free port."""
    console = BrowserConsole(port=0)
    console.open()
    yield console
    console.close()


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium without a window.

    Where there is none the tests are skipped, but in continuous integration they fail: there it
    belongs to what must be installed.
    """
    found = [shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome")]
    path = next(filter(None, found), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        path = None
    if path is None:
        reason = "the page is tested with playwright and an installed Chromium"
        if os.environ.get("CI"):
            pytest.fail(f"{reason}, and one of them is missing")
        pytest.skip(reason)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=path, args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Callable[..., Run]]:
    """Starts runs, and stops them."""
    runs = []

    def start(**options: Any) -> Run:
        runs.append(Run(tmp_path, **options))
        return runs[-1].start()

    yield start
    for each in runs:
        each.stop()


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Any]]:
    """Opens pages, each as a visitor of its own; afterwards none may have met an error."""
    contexts, said = [], []

    def open_page(address: str, script: str = "", **options: Any) -> Any:
        context = browser.new_context(**{"viewport": {"width": 900, "height": 600}, **options})
        contexts.append(context)
        context.set_default_timeout(30_000)
        context.add_init_script(OBSERVER + script)
        page = context.new_page()
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("console", lambda message: note(message.text))
        page.on("request", lambda request: addresses.add(request.url))
        page.goto(address)
        page.locator("#link[data-state=open]").wait_for()
        return page

    def note(text: str) -> None:
        if not any(part in text for part in EXPECTED):
            said.append(text)

    addresses: set[str] = set()
    yield open_page
    for context in contexts:
        context.close()
    assert said == []
    assert {address.split(":")[1] for address in addresses} <= {"//127.0.0.1"}
