"""From steps to what a person is shown of them."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.evaluation.recording import Snapshot
from haim_torchrl.human.console import Figures, Frame, Scene
from haim_torchrl.human.controls import Action
from haim_torchrl.transforms.intervention import Decision

WINDOW = 2000
"""Steps behind the takeover rate shown."""


class Frames:
    """Counts what happens in a run, and makes a frame of each step.

    Args:
        steps: steps that were driven before.
        total_steps: steps of the whole run; 0 if it has no end.
        pace: steps per second, for the time left; None where nobody holds one.

    Attributes:
        last: the frame made last.
    """

    last: Frame

    def __init__(self, steps: int = 0, total_steps: int = 0, pace: float | None = None) -> None:
        self.pace = pace
        self._figures = Figures(steps=steps, total_steps=total_steps)
        self._driven: deque[bool] = deque(maxlen=WINDOW)
        self._episode = -1

    def begin(self, simulator: Any, *, device_ok: bool = True) -> Scene:
        """The scene of a new episode, with its first frame in ``last``.

        Args:
            simulator: a :class:`~haim_torchrl.evaluation.recording.Recordable`, just reset.
            device_ok: whether the person's device works.
        """
        self._episode += 1
        self.last = Frame(
            self._episode, 0, simulator.snapshot(), figures=self._figures, device_ok=device_ok
        )
        return Scene(self._episode, simulator.scenario_labels(), simulator.road_polylines())

    def next(
        self,
        snapshot: Snapshot,
        decision: Decision,
        after: TensorDictBase,
        *,
        fallback: bool = False,
        device_ok: bool = True,
        latency_ms: float | None = None,
        hint: str = "",
    ) -> Frame:
        """The frame of a step.

        Args:
            snapshot: the scene after it.
            decision: who drove, and with what.
            after: what the step led to, the entries under ``next``.
            fallback: whether the fallback drove in the person's place.
            device_ok: whether the person's device works.
            latency_ms: delay of the person's input [ms].
            hint: the coach's.
        """
        driven = decision.intervening
        self._count(decision, after)
        self.last = Frame(
            episode=self._episode,
            step=self.last.step + 1,
            snapshot=snapshot,
            driver="agent" if not driven else "fallback" if fallback else "person",
            action=_pair(decision.executed),
            action_agent=_pair(decision.agent),
            action_mentor=_pair(decision.mentor),
            takeover=driven,
            disturbance=_flag(after, "disturbance"),
            cost=_number(after, "cost"),
            takeover_cost=_number(after, "takeover_cost"),
            disturbance_cost=_number(after, "disturbance_cost"),
            figures=self._figures,
            device_ok=device_ok,
            latency_ms=latency_ms,
            hint=hint,
        )
        return self.last

    def _count(self, decision: Decision, after: TensorDictBase) -> None:
        before = self._figures
        self._driven.append(decision.intervening)
        steps = before.steps + 1
        left = max(before.total_steps - steps, 0) / self.pace if self.pace else None
        self._figures = replace(
            before,
            steps=steps,
            seconds_left=left if before.total_steps else None,
            episodes=before.episodes + _flag(after, "done"),
            successes=before.successes + _flag(after, "success"),
            violations=before.violations + round(_number(after, "cost")),
            takeovers=before.takeovers + decision.starting,
            takeover_rate=sum(self._driven) / len(self._driven),
        )


def outcome(after: TensorDictBase) -> str | None:
    """How an episode ended with a step, in a word or two; None while it goes on.

    Args:
        after: what the step led to, the entries under ``next``.
    """
    if not _flag(after, "done"):
        return None
    names = {
        "success": "arrived",
        "crash": "collision",
        "out_of_road": "off the road",
        "wrong_way": "wrong way",
    }
    return next((text for key, text in names.items() if _flag(after, key)), "time is up")


def _pair(action: Tensor) -> Action:
    acceleration, steering = action.tolist()
    return (acceleration, steering)


def _number(tensordict: TensorDictBase, key: str) -> float:
    value = tensordict.get(key, None)
    return 0.0 if value is None else float(value)


def _flag(tensordict: TensorDictBase, key: str) -> bool:
    return _number(tensordict, key) > 0.0
