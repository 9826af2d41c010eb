"""The example that draws the picture of the documentation."""

from __future__ import annotations

import runpy
from pathlib import Path

import pygame

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "screenshot_window.py"


def test_the_example_draws_the_window(tmp_path: Path) -> None:
    main = runpy.run_path(str(EXAMPLE))["main"]
    path = main(["--steps", "4", "--takeover", "2", "--out", str(tmp_path / "new" / "window.png")])
    assert path.stat().st_size < 200_000
    picture = pygame.image.load(path)
    assert picture.get_size() == (1100, 700)
    assert tuple(picture.get_at((805, 5)))[:3] == (0xD6, 0x27, 0x28)  # the person drives
