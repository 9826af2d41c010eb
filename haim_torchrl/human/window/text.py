"""Text on a surface; what has been written once is kept."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any, Literal

import matplotlib
import pygame

Align = Literal["left", "centre", "right"]
KEPT = 600
"""Pieces of text that are kept as pictures."""


class Writer:
    """Writes in DejaVu Sans, which matplotlib brings along, so that all systems look alike."""

    def __init__(self) -> None:
        pygame.font.init()
        self._folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        self._fonts: dict[tuple[int, bool], Any] = {}
        self._pictures: OrderedDict[tuple[str, int, str, bool], Any] = OrderedDict()

    def write(
        self,
        surface: Any,
        text: str,
        at: tuple[float, float],
        size: int,
        color: str,
        *,
        bold: bool = False,
        align: Align = "left",
    ) -> Any:
        """Write a line.

        Args:
            surface: what to write on.
            text: the line.
            at: its left, middle or right (as ``align`` says) and its vertical middle, in pixels.
            size: height of the font in pixels.
            color: its colour.
            bold: whether it is bold.
            align: what ``at`` is.

        Returns:
            The rectangle that it covers.
        """
        picture = self.picture(text, size, color, bold)
        area = picture.get_rect(centery=round(at[1]))
        setattr(area, {"left": "left", "centre": "centerx", "right": "right"}[align], round(at[0]))
        surface.blit(picture, area)
        return area

    def picture(self, text: str, size: int, color: str, bold: bool = False) -> Any:
        """A line as a surface of its own."""
        key = (text, size, color, bold)
        if key in self._pictures:
            self._pictures.move_to_end(key)
            return self._pictures[key]
        picture = self._font(size, bold).render(text, True, color)
        self._pictures[key] = picture
        if len(self._pictures) > KEPT:
            self._pictures.popitem(last=False)
        return picture

    def wrapped(self, text: str, size: int, width: int, bold: bool = False) -> list[str]:
        """A text in lines that are no wider than ``width`` pixels where words allow."""
        font, lines = self._font(size, bold), [""]
        for word in text.split():
            longer = f"{lines[-1]} {word}".strip()
            if lines[-1] and font.size(longer)[0] > width:
                lines.append(word)
            else:
                lines[-1] = longer
        return lines

    def _font(self, size: int, bold: bool) -> Any:
        if (size, bold) not in self._fonts:
            name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
            self._fonts[size, bold] = pygame.font.Font(str(self._folder / name), size)
        return self._fonts[size, bold]
