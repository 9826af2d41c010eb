"""The platoon behind the vehicle, as a table: most of it is out of the picture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pygame

from haim_torchrl.evaluation.pictures import COLORS
from haim_torchrl.evaluation.recording import Snapshot
from haim_torchrl.human.window.text import Writer

WIDTH, ROW, MOST = 176, 19, 8
BRAKING = "#d62728"


class Followers:
    """Draws gaps and speeds in the lower left corner.

    Args:
        writer: writes.
    """

    def __init__(self, writer: Writer) -> None:
        self._writer = writer

    def draw(self, scene: Any, snapshot: Snapshot) -> None:
        """Draw the nearest followers, if there are any."""
        speeds = np.asarray(snapshot.follower_speeds)[:MOST]
        if not len(speeds):
            return
        area = pygame.Rect(12, 0, WIDTH, 32 + ROW * len(speeds))
        area.bottom = scene.get_height() - 41
        pygame.draw.rect(scene, "#ffffff", area, border_radius=6)
        self._row(scene, area, 14, "followers", "gap m", "m/s", "#6b7480", bold=False)
        for row, (speed, gap, acceleration) in enumerate(
            zip(speeds, snapshot.follower_gaps, snapshot.follower_accelerations)
        ):
            color = BRAKING if acceleration < -1.0 else "#20262d"
            y = 34 + ROW * row
            box = pygame.Rect(area.left + 12, area.top + y - 5, 18, 9)
            pygame.draw.rect(scene, COLORS["followers"], box, border_radius=3)
            self._row(scene, area, y, "", f"{gap:.1f}", f"{speed:.1f}", color)

    def _row(
        self, scene: Any, area: Any, y: int, name: str, gap: str, speed: str, color: str,
        bold: bool = True,
    ) -> None:  # fmt: skip
        if name:
            self._writer.write(scene, name, (area.left + 12, area.top + y), 11, color)
        for text, x in ((gap, 124), (speed, 164)):
            at = (area.left + x, area.top + y)
            self._writer.write(scene, text, at, 11 + bold, color, bold=bold, align="right")
