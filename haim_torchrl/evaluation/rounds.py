"""The rounds of dataset aggregation: how long each is, and how many updates it owes."""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig

from haim_torchrl.evaluation.config import ConfigError, drives_live
from haim_torchrl.evaluation.schedule import Schedule


class Rounds(Schedule):
    """A warm-up of demonstrations, then rounds of driving; after each of them, updates.

    Args:
        settings: The group ``dagger``.
        total_frames: Steps of the whole run, with the warm-up.
    """

    def __init__(self, settings: Any, total_frames: int) -> None:
        super().__init__(settings, total_frames)
        self.warm_up = int(settings.warm_up)
        self.driven = total_frames - self.warm_up
        """Steps after the warm-up."""

    def advance(self, frames: int) -> int:
        """Count steps.

        Returns:
            Number of updates that are now due: those of a round, where one ends.
        """
        self._before = self.frames
        self.frames += frames
        since = self.frames - self.warm_up
        return self._settings.updates if since % self._settings.interactions == 0 else 0

    def owed(self, updates: float) -> int:
        """Updates that are missing to those of the rounds that have ended.

        Args:
            updates: Updates so far; an interrupted run may have done a part of a round's.
        """
        ended = (self.frames - self.warm_up) // self._settings.interactions
        return max((1 + ended) * self._settings.updates - int(updates), 0)


def check_rounds(config: DictConfig) -> None:
    """Refuse settings of ``recipes/dagger.py`` that cannot work.

    Raises:
        ConfigError: With one sentence that names the key.
    """
    settings, total = config.dagger, config.total_frames
    for key in ("warm_up", "interactions", "updates", "batch_size", "log_every"):
        if settings[key] < 1:
            raise ConfigError(f"dagger.{key} must be at least 1; got {settings[key]}")
    if settings.lr <= 0.0:
        raise ConfigError(f"dagger.lr must be positive; got {settings.lr}")
    if settings.keep not in ("mentor", "all"):
        raise ConfigError(f"dagger.keep must be mentor or all; got {settings.keep}")
    ensemble = str(config.objective.get("_target_", "")).endswith(".EnsembleCloningLoss")
    if ensemble and not str(config.actor.get("_target_", "")).endswith("ensemble_actor"):
        raise ConfigError(
            "EnsembleCloningLoss clones an ensemble; use actor=ensemble, or algorithm=iwr for one "
            "policy"
        )
    rounds = (total - settings.warm_up) // settings.interactions
    fits = settings.warm_up + max(rounds, 1) * settings.interactions
    if total != fits:
        raise ConfigError(
            f"total_frames ({total}) must be dagger.warm_up ({settings.warm_up}) and whole rounds "
            f"of dagger.interactions ({settings.interactions}) steps; use total_frames={fits}"
        )
    if drives_live(config):
        raise ConfigError(
            "collector=live drives on while the policy learns, and a round waits for the policy; "
            "use collector=sync"
        )
    frames = int(config.collector.frames_per_batch)
    if frames < 1 or settings.interactions % frames:
        raise ConfigError(
            f"collector.frames_per_batch ({frames}) must divide dagger.interactions "
            f"({settings.interactions})"
        )
    for key in ("capacity", "mentor_capacity"):
        capacity = config.replay[key]
        if capacity is not None and capacity < total:
            raise ConfigError(
                f"replay.{key} ({capacity}) must be at least total_frames ({total}), because "
                "nothing that was aggregated is forgotten"
            )
