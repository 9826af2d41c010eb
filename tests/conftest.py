"""Tests that real time is part of get another chance: a busy machine may stall for seconds."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent
REAL_TIME = tuple(
    HERE / name
    for name in (
        "human/browser",
        "human/window/test_console.py",
        "human/window/test_driving.py",
        "human/test_cockpit.py",
        "human/test_mentor.py",
        "collectors/test_live.py",
        "recipes/test_live.py",
        "recipes/test_person.py",
    )
)
"""What drives at a pace, or talks with a browser or a device that may fall silent."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark them."""
    for item in items:
        if any(path == item.path or path in item.path.parents for path in REAL_TIME):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=1))
