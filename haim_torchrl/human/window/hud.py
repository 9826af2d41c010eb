"""The panel beside the view: who drives, the paper's flags, both actions and the run's figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pygame

from haim_torchrl.evaluation.pictures import COLORS
from haim_torchrl.human.console import Figures, Frame
from haim_torchrl.human.controls import Action
from haim_torchrl.human.window.camera import ribbon
from haim_torchrl.human.window.text import Writer
from haim_torchrl.human.window.view import DRIVERS

WIDTH = 300
"""Width of the panel [pixels]."""
HEIGHT = 680
"""Height that it needs [pixels]."""
PAPER, INK, FAINT, LINE, EMPTY = "#ffffff", "#20262d", "#6b7480", "#d9dde2", "#eceff2"
GOOD, BAD = "#2e9e5b", "#d62728"
NAMES = {"agent": "AGENT DRIVES", "person": "YOU DRIVE", "fallback": "FALLBACK DRIVES"}
EDGE = 18
NOTHING = "\u2013"
"""Where there is no figure: a dash."""


class Panel:
    """Draws the panel.

    Args:
        writer: writes.
        device: the device's name.
    """

    def __init__(self, writer: Writer, device: str) -> None:
        self._writer = writer
        self._device = device

    def draw(self, surface: Any, frame: Frame) -> None:
        """Draw it over the whole surface, 300 pixels wide."""
        surface.fill(PAPER)
        pygame.draw.line(surface, LINE, (0, 0), (0, surface.get_height()))
        surface.fill(DRIVERS[frame.driver], (0, 0, WIDTH, 46))
        self._put(surface, NAMES[frame.driver], WIDTH / 2, 23, 19, "#ffffff", True, "centre")
        self._draw_gauges(surface, frame, 62)
        self._draw_flags(surface, frame, 262)
        self._draw_run(surface, frame.figures, 436)
        self._draw_device(surface, frame, max(surface.get_height(), HEIGHT) - 40)

    def _put(
        self,
        surface: Any,
        text: str,
        x: float,
        y: float,
        size: int = 13,
        color: str = INK,
        bold: bool = False,
        align: Any = "left",
    ) -> None:
        self._writer.write(surface, text, (x, y), size, color, bold=bold, align=align)

    def _draw_gauges(self, surface: Any, frame: Frame, top: int) -> None:
        size = 122
        person = frame.action if frame.driver == "fallback" else frame.action_mentor
        other = "fallback" if frame.driver == "fallback" else "person"
        for x, title, action, color, live in (
            (EDGE, "agent intends", frame.action_agent, DRIVERS["agent"], True),
            (
                WIDTH - EDGE - size,
                "fallback does" if other == "fallback" else "you do",
                person,
                DRIVERS[other],
                frame.driver != "agent",
            ),
        ):
            self._put(surface, title, x + size / 2, top + 8, 13, INK, False, "centre")
            area = pygame.Rect(x, top + 20, size, size)
            self._draw_gauge(surface, area, action, color if live else "#b9c0c8", live)

    def _draw_gauge(self, surface: Any, area: Any, action: Action, color: str, live: bool) -> None:
        """Steering to the side, throttle up, brake down."""
        acceleration, steering = action
        pygame.draw.rect(surface, EMPTY, area, border_radius=8)
        middle = area.center
        pygame.draw.line(surface, LINE, (area.left + 8, middle[1]), (area.right - 9, middle[1]))
        pygame.draw.line(surface, LINE, (middle[0], area.top + 8), (middle[0], area.bottom - 9))
        half = area.width / 2 - 10
        x, y = middle[0] + half * steering, middle[1] - half * acceleration
        if live:
            ribbon(surface, color, np.array([middle, (x, y)], dtype=float), 1.2)
            pygame.draw.aacircle(surface, color, (round(x), round(y)), 7)
        else:
            pygame.draw.aacircle(surface, color, middle, 6, 2)
        for y, value, names in (
            (14, acceleration, ("brake", "pedals", "throttle")),
            (32, steering, ("steer left", "steering", "steer right")),
        ):
            name = names[round(value > 0.005) - round(value < -0.005) + 1] if live else names[1]
            text = f"{abs(value):.2f}" if live else NOTHING
            self._put(surface, name, area.left + 2, area.bottom + y, 12, FAINT)
            self._put(surface, text, area.right - 2, area.bottom + y, 13, INK, True, "right")

    def _draw_flags(self, surface: Any, frame: Frame, top: int) -> None:
        """The flags of the paper's interface, by its names."""
        self._heading(surface, "This step", top)
        speed = frame.snapshot.speed
        rows = (
            ("Takeover", frame.takeover, None, COLORS["mentor"]),
            ("Disturbance", frame.disturbance, None, BAD),
            ("Cost", frame.cost > 0, f"{frame.cost:.0f}", BAD),
            ("Takeover Cost", frame.takeover_cost > 0, f"{frame.takeover_cost:.2f}", BAD),
            ("D Cost", frame.disturbance_cost > 0, f"{frame.disturbance_cost:.2f}", BAD),
            ("Velocity", False, f"{speed:.1f} m/s  ({3.6 * speed:.0f} km/h)", INK),
        )
        for row, (name, on, value, color) in enumerate(rows):
            y = top + 27 + 23 * row
            self._put(surface, name, EDGE, y, 13, INK)
            if value is None:
                value = "yes" if on else "no"
            if on:
                width = self._writer.picture(value, 13, "#ffffff", True).get_width() + 16
                box = pygame.Rect(WIDTH - EDGE - width, y - 10, width, 21)
                surface.fill(color, box.inflate(-20, 0))
                for x in (box.left + 10, box.right - 11):
                    pygame.draw.aacircle(surface, color, (x, y), 10)
                self._put(surface, value, box.centerx, y, 13, "#ffffff", True, "centre")
            else:
                self._put(surface, value, WIDTH - EDGE - 8, y, 13, INK, name == "Velocity", "right")

    def _draw_run(self, surface: Any, figures: Figures, top: int) -> None:
        self._heading(surface, "This run", top)
        rate = f"{100 * figures.takeover_rate:.0f} %"
        done = f"{figures.successes} of {figures.episodes}"
        for row, (name, value) in enumerate(
            (
                ("Success", done),
                ("Violations", f"{figures.violations}"),
                ("Takeovers", f"{figures.takeovers}"),
                ("Takeover rate, last 2000 steps", rate),
            )
        ):
            y = top + 27 + 22 * row
            self._put(surface, name, EDGE, y, 13, INK)
            self._put(surface, value, WIDTH - EDGE - 8, y, 13, INK, True, "right")
        y = top + 27 + 22 * 4
        self._draw_bar(surface, y - 6, figures.takeover_rate, COLORS["mentor"])
        y += 17
        total = f" of {figures.total_steps:,}" if figures.total_steps else ""
        self._put(surface, "Steps", EDGE, y, 13, INK)
        steps = f"{figures.steps:,}{total}".replace(",", "\u2009")
        self._put(surface, steps, WIDTH - EDGE - 8, y, 13, INK, True, "right")
        if figures.total_steps:
            self._draw_bar(surface, y + 16, figures.steps / figures.total_steps, FAINT)
        left = figures.seconds_left
        text = NOTHING if left is None else _duration(left)
        self._put(surface, "Time left", EDGE, y + 38, 13, INK)
        self._put(surface, text, WIDTH - EDGE - 8, y + 38, 13, INK, True, "right")

    def _draw_device(self, surface: Any, frame: Frame, y: int) -> None:
        pygame.draw.line(surface, LINE, (EDGE, y - 18), (WIDTH - EDGE, y - 18))
        color = GOOD if frame.device_ok else BAD
        pygame.draw.aacircle(surface, color, (EDGE + 5, y), 5)
        name = self._device if len(self._device) < 30 else self._device[:28] + "…"
        text = f"{name}: ok" if frame.device_ok else f"{name}: lost"
        self._put(surface, text, EDGE + 18, y, 12, INK if frame.device_ok else BAD)
        if frame.latency_ms is not None:
            delay = f"input within {frame.latency_ms:.0f} ms"
            self._put(surface, delay, EDGE + 18, y + 19, 12, FAINT)

    def _heading(self, surface: Any, text: str, y: int) -> None:
        self._put(surface, text, EDGE, y, 12, FAINT, True)
        pygame.draw.line(surface, LINE, (EDGE + 72, y), (WIDTH - EDGE, y))

    def _draw_bar(self, surface: Any, y: float, share: float, color: str) -> None:
        area = pygame.Rect(EDGE, round(y), WIDTH - 2 * EDGE - 8, 6)
        pygame.draw.rect(surface, EMPTY, area, border_radius=3)
        area.width = round(area.width * min(max(share, 0.0), 1.0))
        if area.width:
            pygame.draw.rect(surface, color, area, border_radius=3)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
