"""How well a run kept its pace."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

LATE = 1.1
"""A step that took longer than this many periods has missed its deadline."""


class StepTimes:
    """Durations of the steps of a run that is driven in real time.

    Pauses and the first steps of episodes are left out.

    Args:
        pace: Steps per second that were wanted; None where nobody held a pace.

    Example:
        >>> times = StepTimes(pace=10.0)
        >>> times.figures()
        {}
    """

    def __init__(self, pace: float | None) -> None:
        self.pace = pace
        self._seconds: list[Tensor] = []
        self._failed = 0

    def add(self, batch: TensorDictBase) -> None:
        """Take the entries ``step_time`` and ``device_ok`` of a batch of any shape, if it has them.

        Args:
            batch: Collected transitions.
        """
        seconds = batch.get(("next", "step_time"), None)
        if seconds is not None and seconds.numel():
            self._seconds.append(seconds[seconds > 0.0].flatten().clone())
            self._failed += int((~batch["next", "device_ok"]).sum())

    def figures(self) -> dict[str, float]:
        """Step times [ms] and missed deadlines; empty where no pace was held.

        Returns:
            ``step_ms_p50``, ``step_ms_p95``, ``step_ms_p99``, ``step_ms_max``, ``steps_timed``,
            ``deadlines_missed`` and ``device_failed_steps``.
        """
        if self.pace is None or not self._seconds:
            return {}
        seconds = torch.cat(self._seconds).double()
        if not len(seconds):
            return {}
        share = torch.tensor([0.5, 0.95, 0.99, 1.0], dtype=torch.float64)
        p50, p95, p99, most = (1000.0 * seconds.quantile(share)).tolist()
        return {
            "step_ms_p50": p50,
            "step_ms_p95": p95,
            "step_ms_p99": p99,
            "step_ms_max": most,
            "steps_timed": float(len(seconds)),
            "deadlines_missed": float((seconds > LATE / self.pace).sum()),
            "device_failed_steps": float(self._failed),
        }

    def __str__(self) -> str:
        figures = self.figures()
        if not figures:
            return ""
        return (
            f"step time p50 {figures['step_ms_p50']:.1f} ms, p95 {figures['step_ms_p95']:.1f} ms, "
            f"p99 {figures['step_ms_p99']:.1f} ms, max {figures['step_ms_max']:.1f} ms; "
            f"{figures['deadlines_missed']:.0f} of {figures['steps_timed']:.0f} steps late by more "
            f"than a tenth, {figures['device_failed_steps']:.0f} without a working device"
        )
