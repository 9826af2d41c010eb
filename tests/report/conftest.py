"""Runs as their folders would have them, with figures that can be worked out by hand."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

FRAMES = 1000


def episode(scenario: int, success: bool, hard_brakes: int, reward: float) -> dict[str, Any]:
    """A test episode of 100 steps; who does not arrive has hit something."""
    return {
        "scenario": scenario,
        "outcome": "success" if success else "crash",
        "violations": 0.0 if success else 1.0,
        "reward": reward,
        "steps": 100,
        "hard_brakes": hard_brakes,
        "hard_brake_onsets": hard_brakes,
        "disturbance_cost": 0.0,
        "distance": 50.0,
        "duration": 10.0,
        "progress": 1.0,
    }


def _table(path: Path, rows: Sequence[dict[str, float]]) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture
def write_run(tmp_path: Path) -> Callable[..., Path]:
    """Writes the folder of a finished run.

    ``successes`` has a 0 or 1 for each test scenario; the return is 300 for an arrival, else 100.
    """

    def write(
        name: str,
        seed: int,
        successes: Sequence[int],
        *,
        folder: str = "runs",
        first: int = 20000,
        frames: int = FRAMES,
        mentor: int = 200,
        hard_brakes: int = 0,
        settings: str = "a",
    ) -> Path:
        where = tmp_path / folder / name / f"seed_{seed}"
        where.mkdir(parents=True)
        config = {"name": name, "seed": seed, "total_frames": frames, "actor": settings}
        world = {"_target_": "haim_torchrl.envs.make_env"}
        (where / "config.yaml").write_text(json.dumps({**config, "env": world}))
        steps = range(100, frames + 1, 100)
        course = [
            {
                "frames": step,
                "mentor_steps_total": mentor * min(step / (frames / 2), 1.0),
                "violations_total": step // 500,
            }
            for step in steps
        ]
        _table(where / "train.csv", course)
        checks = {"success": 0.5, "return": 200.0, "violations": 0.5, "disturbance_rate": 0.01}
        _table(where / "validation.csv", [{"frames": s, **checks} for s in steps if s % 500 == 0])
        contents = {
            "name": name,
            "seed": seed,
            "training": {
                "frames": frames,
                "mentor_steps": mentor,
                "takeovers": 10,
                "violations": 2,
                "hard_brakes": 3,
                "seconds": 90.0 + 60.0 * seed,
            },
            "checkpoint": {"frames": frames},
            "episodes": [
                episode(first + place, bool(s), hard_brakes, 300.0 if s else 100.0)
                for place, s in enumerate(successes)
            ],
        }
        (where / "metrics.json").write_text(json.dumps(contents))
        return where

    return write
