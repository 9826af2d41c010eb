"""Axes and buttons of all gamepads and wheels as they move."""

from __future__ import annotations

import os
import time
from typing import Any

HALF = 20
"""Characters of half a bar."""
EVERY = 0.05
"""Seconds between two looks."""


def bar(value: float) -> str:
    """An axis in [-1, 1] as a bar that grows from its middle.

    Example:
        >>> bar(0.5)
        '[                    |##########          ]'
        >>> bar(-1.0)
        '[####################|                    ]'
    """
    length = round(min(abs(value), 1.0) * HALF)
    left = "#" * length if value < 0.0 else ""
    right = "#" * length if value > 0.0 else ""
    return f"[{left:>{HALF}}|{right:<{HALF}}]"


def describe(sticks: list[Any]) -> str:
    """What pygame's joysticks show now, one line per axis, then buttons and hats."""
    if not sticks:
        return "no gamepad or wheel; plug one in"
    lines = []
    for stick in sticks:
        lines.append(f"{stick.get_name()}  {stick.get_guid()}")
        for i in range(stick.get_numaxes()):
            value = stick.get_axis(i)
            lines.append(f"  axis {i:>2} {value:+.3f} {bar(value)}")
        pressed = [str(i) for i in range(stick.get_numbuttons()) if stick.get_button(i)]
        lines.append(f"  buttons pressed: {' '.join(pressed) or '-'}")
        hats = [str(stick.get_hat(i)) for i in range(stick.get_numhats())]
        lines += [f"  hats: {' '.join(hats)}"] if hats else []
    return "\n".join(lines)


def watch(seconds: float | None) -> bool:
    """Show them until Ctrl-C.

    Args:
        seconds: how long at most; None for ever.

    Returns:
        Whether there was any device.
    """
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    from haim_torchrl.human.availability import joysticks, quiet_pygame

    os.environ["SDL_VIDEODRIVER"] = "dummy"  # events come without a window, too
    os.environ["SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS"] = "1"
    pygame = quiet_pygame()
    pygame.display.init()
    end = float("inf") if seconds is None else time.monotonic() + seconds
    console, seen = Console(), False
    try:
        with joysticks(), Live(console=console, refresh_per_second=1 / EVERY) as live:
            while time.monotonic() < end:
                pygame.event.get()
                # Looked up anew each time, since devices come and go.
                sticks = [pygame.joystick.Joystick(i) for i in range(pygame.joystick.get_count())]
                seen = seen or bool(sticks)
                live.update(Text(describe(sticks)))
                time.sleep(EVERY)
    except KeyboardInterrupt:
        pass
    finally:
        pygame.display.quit()
        if not console.is_terminal:
            console.print()  # there, the last picture has no end of line
    return seen
