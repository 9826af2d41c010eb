"""Checkpoints come back as they were, and what is no checkpoint is said to be none."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.evaluation.checkpoint import (
    CheckpointError,
    find_checkpoint,
    load_checkpoint,
    load_module,
    random_state,
    restore_random_state,
    save_checkpoint,
)


def test_round_trip(tmp_path: Path) -> None:
    contents = {
        "net": torch.nn.Linear(2, 3).state_dict(),
        "data": TensorDict({"a": torch.arange(3), ("b", "c"): torch.zeros(3, 1)}, [3]),
        "array": np.array([1.0, 2.0]),
        "frames": 7,
        "text": "config: {x: 1}",
        "nothing": None,
        "pair": (1, [2.5]),
    }
    path = save_checkpoint(tmp_path / "deep" / "last.pt", contents)
    loaded = load_checkpoint(path)
    assert torch.equal(loaded["net"]["weight"], contents["net"]["weight"])
    assert loaded["data"]["b"]["c"].shape == (3, 1)
    assert loaded["array"].tolist() == [1.0, 2.0]
    assert loaded["frames"] == 7 and loaded["text"] == "config: {x: 1}"
    assert loaded["nothing"] is None and loaded["pair"] == (1, [2.5])


def test_a_failed_write_leaves_the_former_file(tmp_path: Path) -> None:
    path = save_checkpoint(tmp_path / "last.pt", {"frames": 1})
    with pytest.raises(TypeError, match="policy is a object"):
        save_checkpoint(path, {"policy": object()})
    assert load_checkpoint(path)["frames"] == 1
    assert [file.name for file in tmp_path.iterdir()] == ["last.pt"]


def test_random_numbers_go_on_where_they_stood() -> None:
    state = random_state()
    first = (torch.rand(2).tolist(), np.random.rand(2).tolist(), random.random())
    restore_random_state(state)
    assert (torch.rand(2).tolist(), np.random.rand(2).tolist(), random.random()) == first


def test_random_state_survives_the_file(tmp_path: Path) -> None:
    np.random.randn(1)  # leaves a half-used pair of normals in the state
    path = save_checkpoint(tmp_path / "rng.pt", {"random": random_state()})
    first = (torch.rand(2).tolist(), np.random.randn(3).tolist(), random.gauss(0, 1))
    restore_random_state(load_checkpoint(path)["random"])
    assert (torch.rand(2).tolist(), np.random.randn(3).tolist(), random.gauss(0, 1)) == first


def test_missing(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="does not exist"):
        find_checkpoint(tmp_path / "nowhere")
    with pytest.raises(CheckpointError, match="holds no checkpoint"):
        find_checkpoint(tmp_path)
    with pytest.raises(CheckpointError, match="does not exist"):
        load_checkpoint(tmp_path / "nowhere.pt")


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", b"PK\x03\x04broken"])
def test_damaged(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "last.pt").write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged or was not"):
        load_checkpoint(tmp_path / "last.pt")


def test_foreign(tmp_path: Path) -> None:
    torch.save({"weights": torch.zeros(1)}, tmp_path / "other.pt")
    with pytest.raises(CheckpointError, match="not written by this project"):
        load_checkpoint(tmp_path / "other.pt")
    torch.save(torch.zeros(1), tmp_path / "tensor.pt")
    with pytest.raises(CheckpointError, match="not written by this project"):
        load_checkpoint(tmp_path / "tensor.pt")


def test_code_in_a_file_is_not_run(tmp_path: Path) -> None:
    torch.save({"format": Path("x")}, tmp_path / "pickled.pt")
    with pytest.raises(CheckpointError, match="cannot be read"):
        load_checkpoint(tmp_path / "pickled.pt")


def test_later_version(tmp_path: Path) -> None:
    torch.save({"format": "haim_torchrl checkpoint", "version": 99}, tmp_path / "new.pt")
    with pytest.raises(CheckpointError, match="format version 99"):
        load_checkpoint(tmp_path / "new.pt")


def test_a_run_folder_is_enough(tmp_path: Path) -> None:
    path = save_checkpoint(tmp_path / "checkpoints" / "best.pt", {})
    assert find_checkpoint(tmp_path, ("best.pt", "last.pt")) == path
    assert find_checkpoint(tmp_path / "checkpoints", ("last.pt", "best.pt")) == path
    assert find_checkpoint(path) == path


def test_a_net_of_another_size_is_named(tmp_path: Path) -> None:
    net = torch.nn.Linear(2, 3)
    with pytest.raises(CheckpointError, match=r"fit this run's actor"):
        load_module(net, torch.nn.Linear(4, 3).state_dict(), "actor", tmp_path / "a.pt")
