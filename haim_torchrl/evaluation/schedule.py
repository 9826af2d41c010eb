"""What is due when in a training run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Schedule:
    """What is due after each batch.

    Args:
        settings: The group ``train``. Without ``updates_per_step`` no updates are counted.
        total_frames: Steps of the whole run.
    """

    #: The setting that says how long the run is.
    key = "total_frames"

    def __init__(self, settings: Any, total_frames: int) -> None:
        self._settings, self.total_frames = settings, total_frames
        self.frames = 0
        self._owed = 0.0
        self._before = 0

    def advance(self, frames: int) -> int:
        """Count collected steps.

        Returns:
            Number of updates that are now due. A fraction is kept for the next batch.
        """
        self._before = self.frames
        self.frames += frames
        learning = self.frames - max(self._before, self._settings.get("learning_starts", 0))
        self._owed += max(learning, 0) * self._settings.get("updates_per_step", 0.0)
        due = int(self._owed + 1e-9)
        self._owed -= due
        return due

    @property
    def learning(self) -> bool:
        """Whether the last batch reached beyond the steps that nothing is learned in."""
        return self.frames > self._settings.get("learning_starts", 0)

    def due(self, name: str) -> bool:
        """Whether ``log``, ``checkpoint`` or ``validate`` is due: each interval, and at the end."""
        every = self._settings[f"{name}_every"]
        if every == 0:
            return False
        return self.frames // every > self._before // every or self.finished

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self.frames >= self.total_frames

    def state_dict(self) -> dict[str, float]:
        """Counters."""
        return {"frames": self.frames, "owed": self._owed}

    def load_state_dict(self, state: Mapping[str, float]) -> None:
        """Continue from saved counters."""
        self.frames = self._before = int(state["frames"])
        self._owed = float(state["owed"])


class UpdateSchedule(Schedule):
    """What is due after each update of a run that learns from data alone: its steps are updates.

    Args:
        settings: The group ``offline``.
    """

    key = "offline.updates"

    def __init__(self, settings: Any) -> None:
        super().__init__(settings, settings.updates)
