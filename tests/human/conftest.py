"""A console without a screen: the test plays the device, everything behind it is real."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from haim_torchrl.human import Console, Controls, Frame, Reading, Scene


class PlayedConsole:
    """Hands out the reading that a test has set, and keeps what it is shown.

    Args:
        react: what the person does in view of this console; None hands out ``reading``.
    """

    def __init__(self, react: Callable[[PlayedConsole], Reading] | None = None) -> None:
        self.react = react
        self.reading = Reading(connected=True)
        self.scenes: list[Scene] = []
        self.frames: list[Frame] = []
        self.opened = self.closed = self.looks = 0

    def open(self) -> None:
        self.opened += 1

    def read(self) -> Reading:
        self.looks += 1
        return self.reading if self.react is None else self.react(self)

    def begin(self, scene: Scene) -> None:
        self.scenes.append(scene)

    def show(self, frame: Frame) -> None:
        self.frames.append(frame)

    def close(self) -> None:
        self.closed += 1

    def hands(self, kind: str = "keys", **controls: float) -> None:
        """Set what the hands do, on a device that works."""
        self.reading = Reading(Controls(**controls), kind, connected=True)  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def console_class() -> type[PlayedConsole]:
    """The console that is played; ``console_class(react)``."""
    return PlayedConsole


@pytest.fixture
def console() -> PlayedConsole:
    """A console whose person touches nothing at first."""
    made = PlayedConsole()
    assert isinstance(made, Console)
    return made
