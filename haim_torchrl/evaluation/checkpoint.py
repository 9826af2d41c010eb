"""Checkpoints: one file with everything a run needs to go on, written whole or not at all.

The file holds tensors, numbers and strings only, so that it loads with ``weights_only=True``: no
pickled classes or configs that a later version could not read, and no code that runs on loading.
"""

from __future__ import annotations

import os
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

FORMAT = "haim_torchrl checkpoint"
VERSION = 1


class CheckpointError(ValueError):
    """A checkpoint that is missing, foreign or does not fit; the message says what to do."""


def _plain(value: Any, path: str = "") -> Any:
    """The value with tensordicts, arrays and tuples turned into what ``weights_only`` reads."""
    if isinstance(value, Tensor):
        return value.detach()
    if isinstance(value, TensorDictBase):
        return _plain(value.to_dict(), path)
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value.copy())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {key: _plain(item, f"{path}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(_plain(item, f"{path}[{i}]") for i, item in enumerate(value))
    if value is None or isinstance(value, (bool, int, float, str, bytes, torch.dtype)):
        return value
    kind = type(value).__name__
    raise TypeError(f"a checkpoint holds tensors and plain values; {path[1:]} is a {kind}")


def save_checkpoint(path: str | os.PathLike[str], contents: Mapping[str, Any]) -> Path:
    """Write a checkpoint in one step: an interrupted write leaves the former file as it was.

    Args:
        path: File to write; its folder is made.
        contents: Nested mapping of tensors, tensordicts, arrays and plain values.

    Returns:
        The path.

    Raises:
        TypeError: If something in it is none of these; the message names it.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    payload = {"format": FORMAT, "version": VERSION, **_plain(dict(contents))}
    partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as stream:
            torch.save(payload, stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(partial, target)
    finally:
        partial.unlink(missing_ok=True)
    return target


def find_checkpoint(path: str | os.PathLike[str], names: tuple[str, ...] = ("last.pt",)) -> Path:
    """Checkpoint file meant by a path, which may be the file, its folder or the run's folder.

    Args:
        path: What the user gave.
        names: File names to look for in a folder, the preferred first.

    Raises:
        CheckpointError: If there is none.
    """
    given = Path(path).expanduser()
    if given.is_file():
        return given
    for folder in (given / "checkpoints", given):
        for name in names:
            if (folder / name).is_file():
                return folder / name
    where = "holds no checkpoint" if given.is_dir() else "does not exist"
    raise CheckpointError(
        f"checkpoint {given} {where}; give a run's folder such as runs/haim/<date>, "
        "or a .pt file in its checkpoints/"
    )


def load_checkpoint(
    path: str | os.PathLike[str], device: torch.device | str = "cpu"
) -> dict[str, Any]:
    """Read a checkpoint.

    Args:
        path: The file.
        device: Where its tensors go.

    Raises:
        CheckpointError: If it is missing, damaged, or not one of this project's.
    """
    file = Path(path)
    if not file.is_file():
        raise CheckpointError(f"checkpoint {file} does not exist; check the path")
    try:
        contents = torch.load(file, map_location=device, weights_only=True)
    except Exception as error:
        raise CheckpointError(
            f"checkpoint {file} cannot be read ({type(error).__name__}): it is damaged or was not "
            "written by this project; give a .pt file of a run's checkpoints/"
        ) from error
    if not isinstance(contents, dict) or contents.get("format") != FORMAT:
        raise CheckpointError(
            f"checkpoint {file} was not written by this project; "
            "give a .pt file of a run's checkpoints/"
        )
    if contents["version"] != VERSION:
        raise CheckpointError(
            f"checkpoint {file} has format version {contents['version']} but this version of "
            f"haim_torchrl reads {VERSION}; use the version that wrote it"
        )
    return contents


def load_module(module: torch.nn.Module, state: Mapping[str, Any], what: str, source: Path) -> None:
    """Load a state dict and say plainly when it does not fit.

    Args:
        module: Module to fill.
        state: Its saved state dict.
        what: Name of the module for the message.
        source: File that the state came from.

    Raises:
        CheckpointError: If names or shapes differ.
    """
    try:
        module.load_state_dict(dict(state))
    except (RuntimeError, KeyError) as error:
        detail = " ".join(str(error).split())[:300]
        raise CheckpointError(
            f"checkpoint {source} does not fit this run's {what}; use the settings that it was "
            f"written with (it carries them as config): {detail}"
        ) from error


def random_state() -> dict[str, Any]:
    """States of the global random generators of torch, NumPy and Python."""
    name, keys, position, has_gauss, gauss = np.random.get_state(legacy=True)
    version, words, python_gauss = random.getstate()
    state: dict[str, Any] = {
        "torch": torch.get_rng_state(),
        "numpy": {
            "name": str(name),
            "keys": torch.from_numpy(np.asarray(keys).astype(np.int64)),
            "position": int(position),
            "has_gauss": int(has_gauss),
            "gauss": float(gauss),
        },
        "python": {"version": version, "words": list(words), "gauss": python_gauss},
    }
    if torch.cuda.is_available():
        state["cuda"] = torch.cuda.get_rng_state_all()
    return state


def restore_random_state(state: Mapping[str, Any]) -> None:
    """Put the generators back to what :func:`random_state` returned."""
    torch.set_rng_state(state["torch"].cpu())
    numpy_state = state["numpy"]
    np.random.set_state(
        (
            numpy_state["name"],
            numpy_state["keys"].cpu().numpy().astype(np.uint32),
            numpy_state["position"],
            numpy_state["has_gauss"],
            numpy_state["gauss"],
        )
    )
    python_state = state["python"]
    random.setstate((python_state["version"], tuple(python_state["words"]), python_state["gauss"]))
    if "cuda" in state and torch.cuda.is_available():
        torch.cuda.set_rng_state_all([row.cpu() for row in state["cuda"]])
