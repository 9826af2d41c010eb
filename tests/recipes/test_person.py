"""Training with a person, whose keys are pressed by SDL events in a window without a screen."""

from __future__ import annotations

import csv
import json
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pygame
import pytest

from haim_torchrl.data import read_session
from haim_torchrl.human.takeovers import TAKEOVERS_FILE, read_takeovers

SHORT = (
    "preset=smoke", "total_frames=60", "logger=csv", "mentor=keyboard", "collector=sync",
    "collector.frames_per_batch=10", "collector.pace=200", "train.learning_starts=20",
    "train.log_every=30", "train.checkpoint_every=60", "train.validate_every=0",
    "eval.checkpoint=last", "eval.test.count=1", "eval.pictures=false", "eval.show=0",
)  # fmt: skip


@pytest.fixture(autouse=True)
def window_into_memory(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.quit()
    yield
    pygame.quit()


@contextmanager
def fingers(work: Callable[[threading.Event], None]) -> Iterator[None]:
    """Somebody at the keyboard, from when the window is open until the block ends."""
    ended = threading.Event()

    def wait_and_work() -> None:
        while not (pygame.display.get_init() and pygame.display.get_surface()):
            if ended.wait(0.01):
                return
        work(ended)

    thread = threading.Thread(target=wait_and_work)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def post(kind: int, key: int, scancode: int) -> None:
    if pygame.display.get_init():
        pygame.event.post(pygame.event.Event(kind, key=key, scancode=scancode, mod=0, unicode=""))


def tap_throttle(ended: threading.Event) -> None:
    """Presses the arrow up for a moment, again and again."""
    while not ended.wait(0.1):
        for kind in (pygame.KEYDOWN, pygame.KEYUP):
            post(kind, pygame.K_UP, pygame.KSCAN_UP)


def press_escape(ended: threading.Event) -> None:
    """Presses Esc after a while."""
    if not ended.wait(1.0):
        post(pygame.KEYDOWN, pygame.K_ESCAPE, pygame.KSCAN_ESCAPE)


def run_folder(where: Path) -> Path:
    return next((where / "runs" / "smoke").iterdir())


def test_what_a_person_does_is_learned_from_and_written_down(
    tmp_path: Path, command: Callable[..., Any]
) -> None:
    with fingers(tap_throttle):
        outcome = command("haim", *SHORT, "collector.pace=50")
    assert outcome.code == 0, outcome.err
    folder = run_folder(tmp_path)
    session = read_session(folder)
    assert len(session) == 60
    driven = [step for step in session.steps() if step.intervention]
    assert driven and len(driven) < 60
    assert all(step.device_ok for step in session.steps())
    assert any(step.action[0] > 0.9 for step in driven)  # the arrow up is full throttle

    with (folder / "train.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    starts = sum(step.takeover_start for step in session.steps())
    assert sum(float(row["takeovers"]) for row in table) == starts > 0
    assert int(table[-1]["mentor_steps_total"]) == len(driven)
    assert int(table[-1]["updates"]) > 0

    kept = read_takeovers(folder / TAKEOVERS_FILE)
    assert starts - len(kept) in (0, 1)  # the last one may not be over
    assert sum(takeover.length for takeover in kept) <= len(driven)
    report = (folder / "coach.txt").read_text()
    assert report.startswith("driving") and report.strip() in outcome.out

    training = json.loads((folder / "metrics.json").read_text())["training"]
    assert training["steps_timed"] > 0 and training["step_ms_p50"] >= 0.9 * 20.0
    assert training["device_failed_steps"] == 0
    assert f"step time p50 {training['step_ms_p50']:.1f} ms" in outcome.out


def test_escape_saves_and_says_how_to_go_on(tmp_path: Path, command: Callable[..., Any]) -> None:
    with fingers(press_escape):
        outcome = command("haim", *SHORT, "total_frames=10000", "collector.pace=50")
    assert outcome.code == 130, outcome.err
    assert "Traceback" not in outcome.err
    folder = run_folder(tmp_path)
    assert f"saved; go on with: python recipes/haim.py resume={folder}" in outcome.out
    assert (folder / "checkpoints" / "last.pt").exists()
    assert 0 < len(read_session(folder)) < 10_000


def test_a_person_who_touches_nothing_teaches_nothing(command: Callable[..., Any]) -> None:
    outcome = command("haim", *SHORT, "train.no_takeover_after=30")
    assert outcome.code == 1
    assert outcome.err.strip().splitlines()[-1] == (
        "error: no takeover happened in the first 30 steps, so there is nothing to learn from; "
        "choose another switch (switch=shield, switch=dense) or mentor, or raise "
        "train.no_takeover_after"
    )


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="others always have a display")
def test_without_a_display_it_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: Callable[..., Any]
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    outcome = command("haim", "preset=smoke", "mentor=keyboard")
    assert outcome.code == 2
    lines = outcome.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: mentor.console.device=keyboard: ")
    assert "take mentor=browser" in lines[0] and "mentor=expert" in lines[0]
    assert list(tmp_path.rglob("*.*")) == []
