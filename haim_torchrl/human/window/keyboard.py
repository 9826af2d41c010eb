"""The keyboard as a device."""

from __future__ import annotations

import time
from typing import Any

import pygame

from haim_torchrl.human.controls import RELEASED, Controls
from haim_torchrl.human.window.presses import Presses

LEFT = (pygame.KSCAN_LEFT, pygame.KSCAN_A)
RIGHT = (pygame.KSCAN_RIGHT, pygame.KSCAN_D)
THROTTLE = (pygame.KSCAN_UP, pygame.KSCAN_W)
BRAKE = (pygame.KSCAN_DOWN, pygame.KSCAN_S)
TAKEOVER = (pygame.KSCAN_SPACE,)
KEYS = {*LEFT, *RIGHT, *THROTTLE, *BRAKE, *TAKEOVER}


class Keyboard:
    """Arrows or the keys where WASD lie on an English keyboard, and the space bar.

    Args:
        focused: whether the window has the focus at first.
    """

    kind = "keys"
    name = "keyboard"
    help = "arrows or WASD drive   ·   Space takes over"

    def __init__(self, focused: bool = True) -> None:
        self.focused = focused
        self._presses = Presses()

    @property
    def connected(self) -> bool:
        """Whether keys arrive at all."""
        return self.focused

    def handle(self, event: Any) -> bool:
        """Look at an event of the window; whether it was the person's doing."""
        if event.type == pygame.WINDOWFOCUSGAINED:
            self.focused = True
        elif event.type == pygame.WINDOWFOCUSLOST:
            self.focused = False
            self._presses.release_all()
        elif event.type in (pygame.KEYDOWN, pygame.KEYUP) and event.scancode in KEYS:
            if event.type == pygame.KEYDOWN:
                self._presses.press(event.scancode)
            else:
                self._presses.release(event.scancode)
            return True
        return False

    def read(self) -> Controls:
        """Positions of the controls; released without the focus."""
        if not self.focused:
            self._presses.release_all()
            return RELEASED
        pressed = pygame.key.get_pressed()
        # The wrapper is indexed by letter, its tuple by place on the keyboard.
        self._presses.agree({code for code in KEYS if tuple.__getitem__(pressed, code)})
        held = self._presses.look(time.monotonic())
        left, right, throttle, brake, takeover = (
            not held.isdisjoint(keys) for keys in (LEFT, RIGHT, THROTTLE, BRAKE, TAKEOVER)
        )
        return Controls(float(right) - float(left), float(throttle), float(brake), takeover)

    def shown(self) -> None:
        """A step has been shown."""
        self._presses.shown()

    def wants_pause(self, event: Any) -> bool:
        """Whether an event is the button to pause; for keys the window knows that."""
        return False
