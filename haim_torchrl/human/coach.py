"""Watches a person take over, and helps them to do it well."""

from __future__ import annotations

import math
import os
from collections import deque
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase

from haim_torchrl.data.session import scenario_of
from haim_torchrl.human.takeovers import (
    ENOUGH,
    Takeover,
    append_takeover,
    hint,
    place,
)
from haim_torchrl.switches.protocol import Forecasting
from haim_torchrl.transforms.intervention import Decision

RECENT_TAKEOVERS, RECENT_STEPS = 20, 600
"""What a hint is about: the last takeovers, and the last minute of steps of 0.1 s."""


class Coach:
    """Watches a person take over, and says in small print how to do it better.

    For :class:`~haim_torchrl.human.Cockpit` (``coach=``), which calls it after each step. It looks
    closer, with one forecast and one snapshot, at the first step of a takeover only. Since that
    step is over by then, risk and place are those 0.1 s after the onset: the agent's action is
    judged as if it were carried out one step later.

    Args:
        path: File to which each takeover is added when it is over, ``takeovers.jsonl`` in the
            run's folder; None for none. It is made with the first takeover, and may be written by
            another process than the learner's.
        steps_before: Steps that an earlier part of the run drove.
        time_step: Duration of a step [s].

    Attributes:
        takeovers: Those that are over.
        steps: Steps watched.
        mentor_steps: Of them, those that the mentor drove.
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | None = None,
        *,
        steps_before: int = 0,
        time_step: float = 0.1,
    ) -> None:
        self.path = None if path is None else Path(path)
        self.steps_before = steps_before
        self.time_step = time_step
        self.takeovers: list[Takeover] = []
        self.steps = 0
        self.mentor_steps = 0
        self._recent: deque[bool] = deque(maxlen=RECENT_STEPS)
        self._present: dict[str, Any] | None = None  # the takeover that goes on
        self._collisions = 0

    def __call__(self, simulator: Any, decision: Decision, after: TensorDictBase) -> str:
        """Take note of a step.

        Args:
            simulator: The unwrapped simulator, after the step.
            decision: Who drove it, and with what.
            after: What the step led to, the entries under ``next``.

        Returns:
            A hint (:data:`~haim_torchrl.human.takeovers.ADVICE`); empty while there were fewer
            than :data:`ENOUGH` takeovers.
        """
        if self._present is not None and (decision.starting or not decision.intervening):
            self._finish()
        if decision.intervening:
            if self._present is None:
                self._present = self._begin(simulator, decision)
            self._present["length"] += 1
            self.mentor_steps += 1
        else:
            cost, crash = after.get("cost", None), after.get("crash", None)
            happened = crash if cost is None else cost
            self._collisions += 0 if happened is None else math.ceil(float(happened))
        self.steps += 1
        self._recent.append(decision.intervening)
        done = after.get("done", None)
        if self._present is not None and done is not None and bool(done):
            self._finish()
        if len(self.takeovers) < ENOUGH:
            return ""
        rate = sum(self._recent) / len(self._recent)
        return hint(self.takeovers[-RECENT_TAKEOVERS:], rate, self.time_step)

    def _begin(self, simulator: Any, decision: Decision) -> dict[str, Any]:
        risk = time_to_harm = None
        if isinstance(simulator, Forecasting):
            forecast = simulator.forecast(decision.agent.numpy())
            risk = forecast.collision or forecast.departure
            soonest = min(forecast.time_to_collision, forecast.time_to_departure)
            time_to_harm = round(soonest, 2) if risk else None
        collisions, self._collisions = self._collisions, 0
        return {
            "step": self.steps_before + self.steps,
            "length": 0,
            "distance": float(torch.linalg.vector_norm(decision.agent - decision.mentor)),
            "scenario": scenario_of(simulator),
            **place(simulator),
            "risk": risk,
            "time_to_harm": time_to_harm,
            "collisions": collisions,
        }

    def _finish(self) -> None:
        assert self._present is not None
        takeover, self._present = Takeover(**self._present), None
        self.takeovers.append(takeover)
        if self.path is not None:
            append_takeover(self.path, takeover)
