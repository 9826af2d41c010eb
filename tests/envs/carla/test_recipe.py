"""The whole recipe, on the stand-in: training, validation and test share one server."""

from __future__ import annotations

import json
import runpy
import sys
from pathlib import Path

import pytest
import torch

carla = pytest.importorskip("carla")
ROOT = Path(__file__).parents[3]


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Runs the recipe in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    threads = torch.get_num_threads()

    def start(*arguments: str) -> int:
        monkeypatch.setattr(sys, "argv", ["haim.py", "preset=carla", *arguments])
        try:
            runpy.run_path(str(ROOT / "recipes" / "haim.py"), run_name="__main__")
        except SystemExit as end:
            return int(end.code or 0)
        return 0

    yield start
    torch.set_num_threads(threads)


def test_training_validation_and_test(run, server, monkeypatch, tmp_path):
    monkeypatch.setattr(carla, "Client", server.client)
    small = ["total_frames=60", "collector.frames_per_batch=20", "env.observation.size=42"]
    small += ["train.batch_size=8", "train.learning_starts=20", "train.updates_per_step=0.1"]
    small += ["train.validate_every=40", "train.checkpoint_every=60", "train.log_every=20"]
    small += ["eval.validation.count=1", "eval.test.count=1", "switch=always"]
    small += ["env.horizon=15", "env.traffic=3", "env.pedestrians=2", "threads=1"]
    assert run(*small) == 0
    folder = next((tmp_path / "runs" / "carla").iterdir())
    assert json.loads((folder / "metrics.json").read_text())
    assert (folder / "top_view.png").exists()
    loads = [call for call in server.calls if call.startswith("load")]
    assert loads == ["load Town01", "load Town02"]  # training and validation; the test
    assert not server.alive
    assert not server.settings.synchronous_mode


def test_without_a_server_there_is_one_sentence(run, capsys):
    code = run("env.timeout=0.3", "env.ports=[1]")
    error = capsys.readouterr().err
    assert code == 2
    assert error.count("\n") == 1
    assert "127.0.0.1:1 within 0.3 s" in error
    assert "env.ports" in error
