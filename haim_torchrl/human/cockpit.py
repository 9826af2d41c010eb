"""Real time around an environment: holds the pace, waits for the person, shows the scene."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from dataclasses import replace
from multiprocessing.synchronize import Event
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from torchrl.data.tensor_specs import Binary, Composite, Unbounded
from torchrl.envs import EnvBase, Transform

from haim_torchrl.evaluation.recording import Recordable
from haim_torchrl.human.clock import Clock
from haim_torchrl.human.coach import Coach
from haim_torchrl.human.console import Console, Frame, PersonQuit
from haim_torchrl.human.frames import Frames, outcome
from haim_torchrl.human.mentor import HumanMentor
from haim_torchrl.human.takeovers import TAKEOVERS_FILE
from haim_torchrl.transforms.intervention import Decision, InterventionTransform
from haim_torchrl.transforms.recording import SessionRecorder
from haim_torchrl.transforms.worker import simulator_of, transforms_before, worker_env

LOOK_EVERY = 0.03
"""Seconds between two looks at the console while nothing moves."""
ENDING = 10
"""Steps' time for which the end of an episode is shown."""


class _Parts(NamedTuple):
    """Whom a cockpit serves; a tuple, since a module would take its parts for parts of itself."""

    simulator: Any
    takeover: InterventionTransform | None
    person: HumanMentor | None
    console: Console | None
    coach: Coach | None


class Cockpit(Transform):
    """Drives an environment in real time, in front of a person if there is one.

    With a console comes a :class:`~haim_torchrl.human.coach.Coach`, who keeps the takeovers beside
    the session if one is written.

    It goes last, on the side of the simulator: its part before the step is then the first, so that
    the pace is held, and a pause waited out, *before* the mentor is asked for what to do now. A
    person at a console is found in the
    :class:`~haim_torchrl.transforms.InterventionTransform` before it, or given as ``console`` to
    watch an agent that nobody can take over from.

    Written under ``next``, zeros at a reset: ``device_ok [1]`` bool, whether the person's device
    works, and with a pace ``step_time [1]``, seconds between this step and the one before; 0 for
    the first step of an episode and after a pause.

    Args:
        pace: steps per second; None drives as fast as it goes.
        total_steps: steps of the whole run, for what is left; 0 if it has no end.
        steps_before: steps that an earlier part of the run drove.
        console: shows the scene where there is no person who can take over.
        stop: in a process that only drives: is set when the learner has ended. Until then the
            cockpit drives ``total_steps`` and waits.

    Raises:
        ValueError: if the pace is not positive.
    """

    invertible = True

    def __init__(
        self,
        pace: float | None = 10.0,
        *,
        total_steps: int = 0,
        steps_before: int = 0,
        console: Console | None = None,
        stop: Event | None = None,
    ) -> None:
        super().__init__(
            in_keys=[], out_keys=["device_ok"] if pace is None else ["step_time", "device_ok"]
        )
        self.pace = pace
        self.total_steps = total_steps
        self.clock = None if pace is None else Clock(pace)
        self._parts: _Parts | None = None
        self.__dict__["_given"] = console
        self.stop = stop
        self._steps = steps_before
        self._frames = Frames(steps_before, total_steps, pace)
        self._step_time = 0.0
        self._outcome: str | None = None

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """``tensordict`` as it is: without an environment there is nothing to drive."""
        return tensordict

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self._parts is None and self.parent is None:
            return tensordict
        parts = self._get_parts()
        if self.stop is not None and self._steps == self.total_steps:
            self._wait_for_learner(parts)
        if parts.console is not None and self._wait_for_person(parts) and self.clock is not None:
            self.clock.restart()
        passed = None if self.clock is None else self.clock.wait()
        self._step_time = 0.0 if passed is None else passed
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        parts = self._get_parts()
        self._steps += 1
        if self.clock is not None:
            next_tensordict.set("step_time", torch.full((1,), self._step_time))
        ok = parts.person is None or parts.person.device_ok
        next_tensordict.set("device_ok", torch.full((1,), ok))
        if parts.console is not None:
            parts.console.show(self._next_frame(parts, tensordict, next_tensordict))
            self._outcome = outcome(next_tensordict)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        parts = self._get_parts()
        if self.clock is not None:
            self.clock.restart()
            tensordict_reset.set("step_time", torch.zeros(1))
        tensordict_reset.set("device_ok", torch.zeros(1, dtype=torch.bool))
        if parts.console is not None:
            parts.console.open()
            self._show_outcome(parts.console)
            ok = parts.person is None or parts.person.device_ok
            parts.console.begin(self._frames.begin(parts.simulator, device_ok=ok))
            parts.console.show(self._frames.last)
        return tensordict_reset

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the published entries."""
        device = observation_spec.device
        if self.clock is not None:
            observation_spec["step_time"] = Unbounded(shape=(1,), device=device)
        observation_spec["device_ok"] = Binary(1, shape=(1,), dtype=torch.bool, device=device)
        return observation_spec

    @property
    def coach(self) -> Coach | None:
        """Who watches the takeovers, if anybody is shown any."""
        return self._get_parts().coach

    def close(self) -> None:
        """Close the console."""
        if self._parts is not None and self._parts.console is not None:
            self._parts.console.close()

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an environment, and say at once if it is one without a simulator."""
        super().set_container(container)
        self._parts = None
        if isinstance(container, EnvBase):
            worker_env(self)

    def clone(self) -> Cockpit:
        """A cockpit like this one, without environment."""
        twin = super().clone()
        twin._parts = None
        return twin

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"_parts": None}

    # The person.
    def _wait_for_person(self, parts: _Parts) -> bool:
        """Wait while nothing may move; whether there was anything to wait for."""
        waited, shown = False, None
        assert parts.console is not None
        while True:
            if parts.person is not None:
                notice = parts.person.hold()
                quitting = parts.person.reading.quit
            else:
                reading = parts.console.read()
                notice, quitting = "paused" if reading.paused else None, reading.quit
            if quitting:
                self._quit()
            self._end_with_learner()
            if notice is None:
                break
            waited = True
            if notice != shown:
                ok = parts.person is None or parts.person.device_ok
                parts.console.show(replace(self._frames.last, notice=notice, device_ok=ok))
                shown = notice
            time.sleep(LOOK_EVERY)
        return waited

    def _show_outcome(self, console: Console) -> None:
        """Leave the end of an episode on the screen for a moment: the next one begins at once."""
        if self._outcome is None or self.clock is None:
            return
        console.show(replace(self._frames.last, notice=self._outcome))
        self._outcome = None
        until = time.monotonic() + ENDING * self.clock.period
        while time.monotonic() < until:
            console.read()
            time.sleep(min(LOOK_EVERY, self.clock.period))

    def _wait_for_learner(self, parts: _Parts) -> None:
        """All steps are driven, and the learner, which ends this process, may be behind."""
        if parts.console is not None:
            parts.console.show(replace(self._frames.last, notice="all steps are driven"))
        while True:
            self._end_with_learner()
            if parts.console is not None:
                parts.console.read()
            time.sleep(LOOK_EVERY)

    def _quit(self) -> None:
        """End the run: in the learner's process by an exception, else as Ctrl-C there would."""
        parent = multiprocessing.parent_process()
        if parent is None or parent.pid is None:
            raise PersonQuit
        os.kill(parent.pid, signal.SIGINT)
        while True:
            self._end_with_learner()
            time.sleep(LOOK_EVERY)

    def _end_with_learner(self) -> None:
        """End this process, quietly, if it drives for a learner that has ended."""
        parent = multiprocessing.parent_process()
        gone = parent is not None and not parent.is_alive()
        if gone or (self.stop is not None and self.stop.is_set()):
            raise KeyboardInterrupt

    def _next_frame(self, parts: _Parts, step: TensorDictBase, after: TensorDictBase) -> Frame:
        decision = None if parts.takeover is None else parts.takeover.decision
        if decision is None:  # nobody can take over from the agent
            action = step.get("action").detach().cpu()
            decision = Decision(action, torch.zeros_like(action), action, False, False)
        person, hint = parts.person, ""
        if parts.coach is not None:
            hint = parts.coach(parts.simulator, decision, after)
        return self._frames.next(
            parts.simulator.snapshot(),
            decision,
            after,
            fallback=person is not None and person.falling_back,
            device_ok=person is None or person.device_ok,
            latency_ms=None if person is None else person.latency_ms,
            hint=hint,
        )

    def _make_coach(self) -> Coach:
        recorder = next(
            (t for t in transforms_before(self) if isinstance(t, SessionRecorder)), None
        )
        path = None if recorder is None else recorder.path.with_name(TAKEOVERS_FILE)
        return Coach(path, steps_before=self._steps)

    def _get_parts(self) -> _Parts:
        if self._parts is None:
            base = worker_env(self)
            takeovers = (t for t in transforms_before(self) if isinstance(t, InterventionTransform))
            takeover = next(takeovers, None)
            console, person, coach = self._given, None, None
            if takeover is not None and isinstance(takeover.mentor, HumanMentor):
                person = takeover.mentor
                console = person.console
            simulator = simulator_of(base) if takeover is None else takeover.simulator(base)
            if console is not None and not isinstance(simulator, Recordable):
                raise TypeError(
                    f"{type(simulator).__name__} cannot be shown to a person: it lacks snapshot(), "
                    "road_polylines() or scenario_labels()."
                )
            if console is not None and takeover is not None:
                coach = self._make_coach()
            self._parts = _Parts(simulator, takeover, person, console, coach)
        return self._parts
