"""The whole picture: view, panel, and what is written over them."""

from __future__ import annotations

from typing import Any, Literal

import pygame

from haim_torchrl.human.console import Frame, Scene
from haim_torchrl.human.window.followers import Followers
from haim_torchrl.human.window.hud import WIDTH, Panel
from haim_torchrl.human.window.text import Writer
from haim_torchrl.human.window.view import View


class Painter:
    """Draws frames on any surface, on a screen or not.

    Args:
        help: what to drive with, for the line at the bottom.
        device: the device's name.
        view: what is up, the vehicle's heading or +y.
    """

    def __init__(
        self,
        help: str = "",
        device: str = "no device",
        view: Literal["heading", "north"] = "heading",
    ) -> None:
        self._writer = Writer()
        self._view = View(self._writer, view)
        self._panel = Panel(self._writer, device)
        self._followers = Followers(self._writer)
        self._help = "   ·   ".join([*([help] if help else []), "P pause", "Esc quit"])
        self._title = ""

    def begin(self, scene: Scene) -> None:
        """Show a new episode from now on."""
        self._view.begin(scene)
        labels = scene.labels
        blocks = ", ".join(block.replace("_", " ") for block in labels.blocks)
        self._title = f"episode {scene.episode + 1}   ·   scenario {labels.index}: {blocks}"

    def draw(self, surface: Any, frame: Frame) -> None:
        """Draw a step over the whole surface, which shows all of it from 800 by 680 pixels."""
        width, height = surface.get_size()
        split = max(width - WIDTH, 1)
        scene = surface.subsurface((0, 0, split, height))
        self._view.draw(scene, frame)
        self._panel.draw(surface.subsurface((split, 0, width - split, height)), frame)
        clock = f"{frame.snapshot.time:.1f} s"
        self._line(scene, f"{self._title}   ·   {clock}", 14, "#20262d")
        self._line(scene, self._help, height - 15, "#4b5560")
        self._followers.draw(scene, frame.snapshot)
        if frame.hint:
            self._draw_hint(scene, frame.hint, height - 40)
        if frame.notice:
            self._draw_notice(scene, frame.notice)

    def _line(self, scene: Any, text: str, y: int, color: str) -> None:
        picture = self._writer.picture(text, 12, color)
        area = picture.get_rect(midleft=(14, y))
        scene.fill("#f3f5f1", pygame.Rect(0, y - 14, scene.get_width(), 29))
        scene.blit(picture, area)

    def _draw_hint(self, scene: Any, hint: str, bottom: int) -> None:
        lines = self._writer.wrapped(hint, 12, scene.get_width() - 60)[-3:]
        for row, line in enumerate(reversed(lines)):
            picture = self._writer.picture(line, 12, "#20262d")
            area = picture.get_rect(midbottom=(scene.get_width() // 2, bottom - 19 * row))
            scene.fill("#fff8dc", area.inflate(16, 4))
            scene.blit(picture, area)

    def _draw_notice(self, scene: Any, notice: str) -> None:
        """A large banner: nothing moves now."""
        lines = self._writer.wrapped(notice[:1].upper() + notice[1:], 32, scene.get_width() - 80)
        height = 60 + 42 * len(lines)
        top = round(0.26 * scene.get_height() - height / 2)
        shade = pygame.Surface((scene.get_width(), height), pygame.SRCALPHA)
        shade.fill((25, 30, 38, 215))
        scene.blit(shade, (0, top))
        for row, line in enumerate(lines):
            at = (scene.get_width() / 2, top + 51 + 42 * row)
            self._writer.write(scene, line, at, 32, "#ffffff", bold=True, align="centre")
