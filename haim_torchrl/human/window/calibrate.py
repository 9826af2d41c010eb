"""Calibrate a pad or wheel: ``python -m haim_torchrl.human.window.calibrate``.

Asks for one movement after the other in the terminal and writes a small file, which the window
loads whenever that device is used.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pygame

from haim_torchrl.human.console import ConsoleError
from haim_torchrl.human.window.calibration import default_path, save_calibration
from haim_torchrl.human.window.joystick import Kind, find_joystick, read_axes
from haim_torchrl.human.window.system import environment, open_joysticks, shut_down
from haim_torchrl.human.window.wizard import Wizard

LOOK_EVERY = 0.01


def calibrate(
    kind: Kind,
    path: Path | None = None,
    *,
    say: Callable[[str], Any] = print,
    sleep: Callable[[float], Any] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> Path:
    """Ask for the movements and write the file; pygame's display and joysticks must be open.

    Args:
        kind: pad or wheel; the first one found is taken.
        path: file to write; None for where the window looks.
        say: shows a line.
        sleep: waits for so many seconds.
        clock: the time in seconds.

    Returns:
        The file.

    Raises:
        ConsoleError: if there is no such device, or if it is unplugged meanwhile.
    """
    stick = find_joystick(kind)
    say(f"{stick.get_name()}: {stick.get_numaxes()} axes, {stick.get_numbuttons()} buttons")
    wizard, asked = Wizard(kind), None
    while wizard.prompt is not None:
        if wizard.prompt != asked:
            asked = wizard.prompt
            say(asked)
        sleep(LOOK_EVERY)
        for event in pygame.event.get():
            removed = event.type == pygame.JOYDEVICEREMOVED
            if removed and event.instance_id == stick.get_instance_id():
                raise ConsoleError("the device was unplugged; nothing is written.")
        held = {k for k in range(stick.get_numbuttons()) if stick.get_button(k)}
        wizard.feed(clock(), read_axes(stick), held)
    target = path or default_path(stick.get_guid())
    return save_calibration(wizard.mapping, target, stick.get_name())


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = argparse.ArgumentParser(description="Calibrate a pad or wheel for the window.")
    parser.add_argument("--device", choices=("wheel", "gamepad"), default="wheel")
    parser.add_argument("--path", type=Path, help="file to write (default: where it is looked for)")
    options = parser.parse_args(arguments)
    try:
        with environment("SDL_VIDEODRIVER", "dummy"):  # the terminal is enough
            pygame.display.init()
        open_joysticks()
        print(f"written: {calibrate(options.device, options.path)}")
    except ConsoleError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; nothing is written.", file=sys.stderr)
        return 130
    finally:
        shut_down()
    return 0


if __name__ == "__main__":
    sys.exit(main())
