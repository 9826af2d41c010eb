"""Writes every step that agent and mentor drive to a file, as it is driven."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, NamedTuple

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.envs import EnvBase, Transform

from haim_torchrl.data.session import fingerprint, scenario_of
from haim_torchrl.data.session_writer import SessionWriter
from haim_torchrl.mentors.protocol import Mentor
from haim_torchrl.transforms.intervention import InterventionTransform
from haim_torchrl.transforms.worker import transforms_before, worker_env


class _Driven(NamedTuple):
    """Who drives what; a tuple, since a module would take its parts for parts of itself."""

    takeover: InterventionTransform
    simulator: Any
    mentor: Mentor


class SessionRecorder(Transform):
    """Writes what :class:`~haim_torchrl.transforms.InterventionTransform` published to a session.

    It changes no data, and goes after the intervention transform, on the side of the simulator. The
    file (:class:`~haim_torchrl.data.SessionWriter`) is opened with the first step, in the process
    that drives it, and closed with the environment. ``state_dict`` holds the number of steps, so
    that an environment which goes on from a checkpoint goes on with its session; steps that were
    driven after the checkpoint are kept in a file beside it.

    Args:
        path: File to write.
        process: Id of the process that ``path`` is meant for; in another one, such as a
            collector's worker, the id is added to the name: ``session-4711.jsonl``. None stands
            for the process of the first step.
        seed: Seed of the run, for the header.
        settings: Settings of the run as text, for the header.
        observation_key: What the agent sees, of which a checksum is kept: it shows whether the
            session, driven again, is still the same.

    Raises:
        RuntimeError: On first use, if there is no intervention transform before it.
        FileExistsError: At the first step, if the file exists.

    Examples:
        >>> import tempfile
        >>> from torchrl.envs import Compose, GymEnv, TransformedEnv
        >>> from haim_torchrl.data import read_session
        >>> from haim_torchrl.mentors import FunctionMentor
        >>> from haim_torchrl.switches import Always
        >>> def mentor():
        ...     return FunctionMentor(lambda simulator, tensordict: [1.5])
        >>> path = tempfile.mkdtemp() + "/session.jsonl"
        >>> chain = Compose(InterventionTransform(mentor, Always()), SessionRecorder(path))
        >>> env = TransformedEnv(GymEnv("Pendulum-v1"), chain)
        >>> rollout = env.rollout(3)
        >>> env.close()
        >>> [step.action for step in read_session(path).steps()]
        [(1.5,), (1.5,), (1.5,)]
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        process: int | None = None,
        seed: int | None = None,
        settings: str | None = None,
        observation_key: NestedKey = "observation",
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        self.path = Path(path)
        self.process = process
        self.header = {"seed": seed, "settings": settings}
        self.observation_key = observation_key
        self._writer: SessionWriter | None = None
        self._driven: _Driven | None = None
        self._begins, self._versioned = True, False

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        self._begins = True  # written with the first step: a reset alone is no episode
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        takeover, simulator, mentor = self._driven or self._find_takeover()
        writer = self._writer or self._open()
        if self._begins:
            writer.begin_episode(
                scenario=scenario_of(simulator), random_state=takeover.random_state
            )
            self._begins = False
            self._versioned = tensordict.get("policy_version", None) is not None
        decision = takeover.decision
        assert decision is not None
        seen = tensordict.get(self.observation_key, None)
        writer.add(
            decision.agent.tolist(),
            decision.mentor.tolist(),
            decision.executed.tolist(),
            intervention=decision.intervening,
            takeover_start=decision.starting,
            done=next_tensordict.get("done").item(),
            device_ok=bool(getattr(mentor, "device_ok", True)),
            latency_ms=getattr(mentor, "latency_ms", None),
            policy_version=_plain(tensordict["policy_version"]) if self._versioned else None,
            observation=None if seen is None else fingerprint(seen.numpy(force=True)),
        )
        return next_tensordict

    def close(self) -> None:
        """Close the session."""
        if self._writer is not None:
            self._writer.close()

    def get_extra_state(self) -> Tensor:
        """Name of the file and number of steps in it, as bytes; what was written is on disk."""
        writer = self._writer
        state: dict[str, Any] = {"file": None, "steps": 0}
        if writer is not None:
            writer.sync()
            state = {"file": writer.path.name, "steps": writer.steps}
        return torch.frombuffer(bytearray(json.dumps(state).encode()), dtype=torch.uint8)

    def set_extra_state(self, state: Tensor) -> None:
        """Go on with the session after the steps that were saved.

        Raises:
            SessionError: If the file is missing, damaged, or shorter.
        """
        saved = json.loads(bytes(state.tolist()).decode())
        self.close()
        self._writer = None
        if saved["file"] is not None:
            file = self.path.with_name(saved["file"])
            self._writer = SessionWriter.resume(file, saved["steps"])
        self._begins = True

    def clone(self) -> SessionRecorder:
        """A recorder like this one, without environment or file."""
        twin = super().clone()
        twin._writer = twin._driven = None
        return twin

    def __getstate__(self) -> dict[str, Any]:
        return super().__getstate__() | {"_writer": None, "_driven": None}

    def set_container(self, container: Transform | EnvBase) -> None:
        """Attach to an environment, and say at once if it is one without a simulator."""
        super().set_container(container)
        self._driven = None
        if isinstance(container, EnvBase):
            worker_env(self)

    def _find_takeover(self) -> _Driven:
        base = worker_env(self)
        for transform in transforms_before(self):
            if isinstance(transform, InterventionTransform):
                self._driven = _Driven(transform, transform.simulator(base), transform.mentor)
                return self._driven
        raise RuntimeError(
            "SessionRecorder writes down what an InterventionTransform publishes, and there is "
            "none before it."
        )

    def _open(self) -> SessionWriter:
        path = self.path
        if self.process is not None and self.process != os.getpid():
            path = path.with_name(f"{path.stem}-{os.getpid()}{path.suffix}")
        self._writer = SessionWriter(path, **self.header)  # type: ignore[arg-type]
        return self._writer


def _plain(version: Any) -> int | float | str:
    """A policy's version as a plain value; TorchRL has numbers and texts."""
    return version.item() if isinstance(version, Tensor) else version
