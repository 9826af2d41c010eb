"""A sweep: several runs by one command, gathered, gone on with after an interruption."""

from __future__ import annotations

import csv
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

SETTINGS = ("preset=smoke", "total_frames=150", "train.validate_every=150", "eval.test.count=1")


def test_a_sweep_goes_on_where_it_stopped(
    tmp_path: Path, starter: Callable[..., subprocess.Popen[str]]
) -> None:
    def sweep(followers: str) -> tuple[int, str, str]:
        process = starter(
            tmp_path, "haim", "--config-name", "ablation", *SETTINGS, "hydra.sweep.dir=runs/sweep",
            "method=proxy_q", "seed=0", f"env.followers={followers}",
        )  # fmt: skip
        out, err = process.communicate(timeout=240)
        return process.returncode, out, err

    # A run that cannot work leaves the other one alone, and the command fails after all.
    code, out, err = sweep("0,5")
    assert code == 1, err
    folder = tmp_path / "runs" / "sweep"
    (good,) = (path.parent for path in folder.rglob("metrics.json"))
    (bad,) = (path.parent for path in folder.rglob("error.txt"))
    assert "env.followers=5" in good.name and "env.followers=0" in bad.name
    assert "must be between 1 and 5" in (bad / "error.txt").read_text()
    assert f"{bad.name} failed: " in err and "Traceback" not in err
    assert f"{good.name}: 150/150 steps" in out
    (row,) = csv.DictReader((folder / "comparison.csv").open())
    assert row["seed"] == "0" and 0.0 < float(row["mentor-driven steps"]) <= 150.0
    assert "| 1 |" in (folder / "comparison.md").read_text().splitlines()[2]
    assert (folder / "comparison.png").stat().st_size > 10_000

    # What is finished is not run again; a run whose test was interrupted does the test.
    before = json.loads((good / "metrics.json").read_text())
    code, out, err = sweep("5")
    assert "is finished and not run again" in out and "150/150" not in out
    assert code == 1 and "env.followers=0" in err  # the failed run is still there
    (good / "metrics.json").unlink()
    (bad / "error.txt").unlink()
    code, out, err = sweep("5")
    assert code == 0, err
    assert "1/1 episodes test" in out
    after = json.loads((good / "metrics.json").read_text())
    assert after["episodes"] == before["episodes"]
    assert after["training"]["mentor_steps"] == before["training"]["mentor_steps"]

    # What never came to a checkpoint begins anew, and nothing of it is overwritten.
    (good / "metrics.json").unlink()
    (good / "checkpoints" / "last.pt").unlink()
    code, out, err = sweep("5")
    assert code == 0, err
    assert (folder / f"{good.name}.unsaved1" / "train.csv").exists()
    assert (good / "metrics.json").exists()
