"""What a run was trained and tested with, in a few words that tell runs of a method apart."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

INCIDENTAL = frozenset(
    ("name", "seed", "device", "threads", "compile", "resume", "record", "logger", "total_frames")
)
"""Settings that two runs of one method may differ in (the budget is compared by itself)."""


@dataclass(frozen=True)
class Settings:
    """Settings of a run; None for what is not known.

    Attributes:
        world: The world, such as ``platoon`` or ``metadrive``.
        total_frames: Environment steps asked for.
        digest: Short hash of all settings but :data:`INCIDENTAL` and those of the evaluation.
        demonstrations: The dataset learned from; of a folder given in full, its name.
    """

    world: str | None = None
    total_frames: int | None = None
    digest: str | None = None
    demonstrations: str | None = None


def read_settings(folder: Path) -> Settings:
    """The settings in a run's ``config.yaml``; unknown ones without such a file.

    Raises:
        ValueError: If the file is no YAML mapping.
    """
    path = folder / "config.yaml"
    if not path.exists():
        return Settings()
    try:
        contents = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    except Exception as error:  # a YAML error has many types
        raise ValueError(f"{path} cannot be read: {' '.join(str(error).split())}") from None
    if not isinstance(contents, Mapping):
        raise ValueError(f"{path} holds no settings")
    rest = {str(k): v for k, v in contents.items() if k not in INCIDENTAL | {"eval"}}
    text = json.dumps(rest, sort_keys=True, default=str)
    frames = contents.get("total_frames")
    return Settings(
        _world(contents.get("env")),
        None if frames is None else int(frames),
        hashlib.sha256(text.encode()).hexdigest()[:12],
        _dataset(contents.get("demonstrations")),
    )


def evaluated_set(folder: Path) -> str:
    """The scenario set of an evaluation by its ``config.yaml``; ``test`` without such a file."""
    path = folder / "config.yaml"
    chosen = OmegaConf.select(OmegaConf.load(path), "eval.set") if path.exists() else None
    return str(chosen or "test")


def _world(env: Any) -> str | None:
    """A world's name from the module of its factory: ``platoon`` for the package's own."""
    if not isinstance(env, Mapping) or "_target_" not in env:
        return None
    package = str(env["_target_"]).split(".")[-2:-1]
    return "platoon" if package in ([], ["envs"]) else package[0]


def _dataset(given: Any) -> str | None:
    """A dataset as others can name it: its id or relative folder, of a full path the last part."""
    if given is None:
        return None
    return Path(str(given)).name if Path(str(given)).is_absolute() else str(given)
