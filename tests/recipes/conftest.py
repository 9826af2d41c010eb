"""Recipes run as commands, in this process or in one of their own."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[2]


@dataclass
class Outcome:
    """What a command left: exit code, stdout, stderr."""

    code: int
    out: str
    err: str


@pytest.fixture
def command(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[..., Outcome]]:
    """Runs a recipe in this process, in an empty folder."""
    threads = torch.get_num_threads()
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HYDRA_FULL_ERROR", raising=False)

    def run(recipe: str, *arguments: str) -> Outcome:
        monkeypatch.setattr(sys, "argv", [f"{recipe}.py", *arguments])
        monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
        code = 0
        capsys.readouterr()
        try:
            runpy.run_path(str(ROOT / "recipes" / f"{recipe}.py"), run_name="__main__")
        except SystemExit as end:
            code = int(end.code or 0)
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    yield run
    torch.set_num_threads(threads)


def start(folder: Path, recipe: str, *arguments: str) -> subprocess.Popen[str]:
    """Starts a recipe as a process of its own in ``folder``."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment.pop("HYDRA_FULL_ERROR", None)
    return subprocess.Popen(
        [sys.executable, str(ROOT / "recipes" / f"{recipe}.py"), *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@dataclass
class Trained:
    """A finished run: its folder and what it printed."""

    folder: Path
    out: str


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """The smoke preset, run once from end to end."""
    where = tmp_path_factory.mktemp("smoke")
    process = start(where, "haim", "preset=smoke")
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return Trained(next((where / "runs" / "smoke").iterdir()), out)


@pytest.fixture(scope="session")
def starter() -> Callable[..., subprocess.Popen[str]]:
    """Starts a recipe as a process of its own."""
    return start
