"""The how-to for a term of one's own, done as it says."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import yaml

from haim_torchrl.objectives import CostCriticLoss

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "howto" / "new_term.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)


def test_the_term_of_the_howto_trains_by_its_command(tmp_path: Path) -> None:
    (term,), (member, _), (command,) = blocks("python"), blocks("yaml"), blocks("bash")
    (tmp_path / "comfort.py").write_text(term)
    (tmp_path / "my_conf" / "loss" / "comfort").mkdir(parents=True)
    (tmp_path / "my_conf" / "loss" / "comfort" / "squared.yaml").write_text(member)
    python, recipe = f"{sys.executable} {ROOT}/recipes/haim.py", "python recipes/haim.py"
    assert recipe in command
    shell = command.strip().replace(recipe, python).replace("PYTHONPATH=.", f"PYTHONPATH=.:{ROOT}")
    done = subprocess.run(
        f"{shell} preset=smoke total_frames=200 train.validate_every=200 eval.test.count=1",
        shell=True,
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    (table,) = (tmp_path / "runs").rglob("train.csv")
    last = list(csv.DictReader(table.open()))[-1]
    assert 0.0 < float(last["loss_comfort"]) <= 0.01 * 2  # weight times |a|^2 of two components


def test_the_cost_of_the_howto_is_one_that_the_class_takes() -> None:
    settings = yaml.safe_load(blocks("yaml")[1])
    assert settings["term"]["_target_"].rpartition(".")[2] == CostCriticLoss.__name__
    assert set(settings["keys"]) <= set(CostCriticLoss.default_keys.__dataclass_fields__)
