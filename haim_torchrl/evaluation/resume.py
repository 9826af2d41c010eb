"""The settings that a run goes on with, or that its policy is evaluated with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hydra.conf import HydraConf
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.evaluation.checkpoint import CheckpointError, find_checkpoint, load_checkpoint
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.schema import BaseConfig, ResumableConfig


def resumed_config(
    config: DictConfig, hydra: HydraConf, schema: type[ResumableConfig]
) -> DictConfig:
    """The settings to resume with: those of the checkpoint, and the values given now.

    Args:
        config: Settings composed from the files and the command line; ``resume`` is set.
        hydra: Hydra's own settings of this job, with the overrides and the members chosen.
        schema: Types of the settings.

    Raises:
        CheckpointError: If there is no such checkpoint.
        ConfigError: If a part is to be exchanged: the saved state would not fit it.
    """
    path = find_checkpoint(config.resume)
    contents = load_checkpoint(path)
    saved, parts = saved_config(contents, path), contents.get("choices", {})
    result = OmegaConf.merge(OmegaConf.structured(schema), saved)
    assert isinstance(result, DictConfig)
    for text, key, value in _overrides(hydra):
        if key not in hydra.runtime.choices:
            OmegaConf.update(result, key, OmegaConf.select(config, key), force_add=False)
        elif parts.get(key) != value:
            raise ConfigError(
                f"{text} cannot be combined with resume, which keeps the run's own "
                f"{key}={parts.get(key)}; start a new run to change it"
            )
    recorded = bool(saved.get("record", False))
    if result.get("record", recorded) != recorded:
        raise ConfigError(
            f"record={result.record} cannot be combined with resume, which keeps the run's own "
            f"record={recorded}; start a new run to change it"
        )
    return result


def evaluated_config(config: DictConfig, hydra: HydraConf, path: Path) -> DictConfig:
    """The settings to evaluate a policy with: the world it was trained in, and what is given now.

    Args:
        config: Settings composed from the files and the command line.
        hydra: Hydra's own settings of this job.
        path: The policy's checkpoint.

    Raises:
        CheckpointError: If the checkpoint is missing or foreign.
    """
    saved = saved_config(load_checkpoint(path), path)
    shared = [key for key in BaseConfig.__dataclass_fields__ if key in saved and key != "name"]
    # A group is the checkpoint's as a whole: two members of it may have different keys.
    groups = {key for key in shared if key != "eval" and OmegaConf.is_dict(saved[key])}
    rest = OmegaConf.masked_copy(config, [key for key in map(str, config) if key not in groups])
    result = OmegaConf.merge(rest, OmegaConf.masked_copy(saved, shared))
    assert isinstance(result, DictConfig)
    result.eval.set = config.eval.set
    for _, key, _ in _overrides(hydra):
        if key != "eval":
            merge = key not in hydra.runtime.choices
            OmegaConf.update(result, key.replace("/", "."), _selected(config, key), merge=merge)
    return result


def _selected(config: DictConfig, key: str) -> Any:
    return OmegaConf.select(config, key.replace("/", "."))


def _overrides(hydra: HydraConf) -> list[tuple[str, str, str]]:
    """Overrides of the command line: text, key or group, value."""
    found = []
    for text in hydra.overrides.task:
        key, _, value = text.partition("=")
        found.append((text, key.lstrip("+~").partition("@")[0], value))
    return found


def saved_config(contents: Mapping[str, Any], path: Path) -> DictConfig:
    """The settings that a checkpoint was written with.

    Raises:
        CheckpointError: If it carries none.
    """
    config = OmegaConf.create(str(contents.get("config", "")))
    if not isinstance(config, DictConfig) or not config:
        raise CheckpointError(f"checkpoint {path} carries no settings; give one of a run")
    return config
