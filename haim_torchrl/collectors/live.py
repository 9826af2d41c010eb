"""Collection in real time: the simulator and its person in one process, the learner in another."""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl import logger as torchrl_logger
from torchrl.collectors import AsyncCollector
from torchrl.data import LazyMemmapStorage, ReplayBuffer
from torchrl.envs import EnvBase, TransformedEnv

from haim_torchrl.collectors.acting import as_acting_policy
from haim_torchrl.collectors.mixed_policy import CollectedEnv, EnvFactory
from haim_torchrl.human.cockpit import Cockpit
from haim_torchrl.transforms.policy_version import PolicyVersion
from haim_torchrl.transforms.transition import TakeoverToTransition

HEARTBEAT = 0.5
"""Seconds without a whole batch after which an empty one is handed out."""
YIELD = 10
"""Niceness of the learner while it learns beside driving in real time."""
LOOK_EVERY = 0.005
"""Seconds between two looks at what has come."""


class LiveCollectorError(RuntimeError):
    """The driving cannot go on; the message says why and what to do."""


class LiveCollector:
    """Collects from an environment that never waits for the learner.

    TorchRL's ``AsyncCollector`` drives the environment in a process of its own and writes each
    few transitions to a replay buffer in shared memory. This end reads them there, in order and
    none twice, and hands them out as batches of ``frames_per_batch``, however long the learner was
    busy. While nothing comes, because the person pauses, it hands out an empty batch (of size
    ``[0]``) twice a second, so that the learner can look at something else. New weights of the
    policy reach the driving process through shared memory (:meth:`update_policy_weights_`).

    Batches have a fixed size and hold the same steps in the same order whatever the timing, so
    what is learned from a session is a matter of its transitions alone: driven again
    (``mentor=replay``), it gives the same learning curve.

    The process starts with the iteration and is not reset at checkpoints: a simulator cannot be
    saved in the middle of a person's drive. A resumed run begins a new episode, with new seeds.

    Args:
        env_factory: builds the environment, in the other process.
        policy: the agent.
        frames_per_batch: steps in a batch; with few, the learner hears of a takeover soon.
        total_frames: steps until the iteration ends.
        seed: seeds the simulator and exploration.
        pace: steps per second; None drives as fast as it goes.
        backlog: steps that the learner may be behind.

    Raises:
        ValueError: numbers that do not fit together.
    """

    def __init__(
        self,
        env_factory: EnvFactory,
        policy: TensorDictModuleBase,
        *,
        frames_per_batch: int = 5,
        total_frames: int,
        seed: int | None = None,
        pace: float | None = 10.0,
        backlog: int = 20_000,
    ) -> None:
        if frames_per_batch < 1 or total_frames < 1:
            raise ValueError(
                f"frames_per_batch is {frames_per_batch} and total_frames {total_frames}: both "
                "must be positive."
            )
        if backlog < 2 * frames_per_batch:
            raise ValueError(
                f"backlog is {backlog}: it must hold at least two batches of {frames_per_batch}."
            )
        self.env_factory = env_factory
        self.policy = policy
        self.frames_per_batch = frames_per_batch
        self.total_frames = total_frames
        self.seed = seed
        self.pace = pace
        self.backlog = backlog
        self.frames = 0
        """Steps handed out."""
        self._frames_before = 0
        self._collector: AsyncCollector | None = None
        self._niceness: int | None = None
        self._mailbox: ReplayBuffer | None = None
        context = multiprocessing.get_context("spawn")
        self._stop = context.Event()
        # A semaphore is the one counter that cloudpickle lets through to the other process.
        self._updates = context.Semaphore(0)

    def __iter__(self) -> Iterator[TensorDictBase]:
        """Batches ``[frames_per_batch]``, and empty ones while nothing comes.

        Raises:
            LiveCollectorError: If the driving process ended, or the learner fell too far behind.
        """
        if self._collector is None:
            self._start()
        assert self._mailbox is not None
        read, since = self.frames - self._frames_before, time.monotonic()
        while self.frames < self.total_frames:
            written = self._written()
            if written - read > self.backlog:
                raise LiveCollectorError(
                    f"the learner is {written - read} steps behind the driving, more than "
                    f"collector.backlog ({self.backlog}); lower train.updates_per_step, or "
                    "collector.pace"
                )
            if written - read >= self.frames_per_batch:
                rows = torch.arange(read, read + self.frames_per_batch) % self.backlog
                batch = self._mailbox[rows].clone()
                read += self.frames_per_batch
                self.frames += self.frames_per_batch
                since = time.monotonic()
                yield batch
            elif time.monotonic() - since > HEARTBEAT:
                since = time.monotonic()
                self._check_process()
                yield self._mailbox[torch.zeros(0, dtype=torch.long)]
            else:
                time.sleep(LOOK_EVERY)

    def update_policy_weights_(self) -> None:
        """Let the driving process act with the policy's present weights."""
        if self._collector is not None:
            self._collector.update_policy_weights_()
            self._updates.release()

    def reset(self) -> None:
        """Nothing: the person's episode goes on."""

    def shutdown(self) -> None:
        """End the driving process; its environment closes window, page and session."""
        self._stop.set()
        if self._collector is not None:
            self._collector.shutdown(timeout=10.0)
            self._collector = None
            atexit.unregister(self.shutdown)
            if self._niceness is not None:
                with contextlib.suppress(PermissionError):  # not all may take priority back
                    os.setpriority(os.PRIO_PROCESS, 0, self._niceness)

    def state_dict(self) -> dict[str, Any]:
        """The number of steps handed out."""
        return {"frames": self.frames}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on after them."""
        self.frames = self._frames_before = int(state_dict["frames"])

    def _start(self) -> None:
        seed = None if self.seed is None else _mixed(self.seed, self._frames_before)
        build = LiveEnv(
            self.env_factory,
            seed=seed,
            in_worker=True,
            pace=self.pace,
            total_frames=self.total_frames,
        )
        build.frames_before = self._frames_before
        build.updates = self._updates
        env = build()
        try:
            transition = TakeoverToTransition()(env.fake_tensordict())
        finally:
            env.close()
        self._mailbox = ReplayBuffer(
            storage=LazyMemmapStorage(self.backlog), batch_size=1, shared=True
        )
        level = torchrl_logger.level
        torchrl_logger.setLevel("WARNING")  # it would announce the storage to the person
        self._mailbox.extend(transition.unsqueeze(0))
        torchrl_logger.setLevel(level)
        self._mailbox.empty()
        build.stop = self._stop
        self._collector = AsyncCollector(
            build,
            as_acting_policy(self.policy),
            replay_buffer=self._mailbox,
            frames_per_batch=self.frames_per_batch,
            total_frames=-1,
            postproc=TakeoverToTransition(keep=list(transition.keys(True, True))),
            auto_register_policy_transforms=False,
        )
        self._collector.start()
        if self.pace is not None:  # where both want a core, the driving comes first
            self._niceness = os.getpriority(os.PRIO_PROCESS, 0)
            os.setpriority(os.PRIO_PROCESS, 0, max(self._niceness, YIELD))
        atexit.register(self.shutdown)  # else the end of this process would wait for that one

    def _written(self) -> int:
        assert self._mailbox is not None
        # The count goes up before the rows are there; who writes holds the lock until they are.
        with self._mailbox._write_lock:
            return self._mailbox.write_count

    def _check_process(self) -> None:
        assert self._collector is not None
        if not all(process.is_alive() for process in self._collector.procs):
            raise LiveCollectorError(
                "the process that drives has ended; what it said stands above. The steps that it "
                "drove are in the session file"
            )


class LiveEnv(CollectedEnv):
    """Builds the environment in the driving process, which leaves Ctrl-C to the learner.

    Attributes:
        frames_before: steps that an earlier part of the run drove.
        stop: set when the driving is to end; None while the environment is only looked at.
        updates: counts the updates of the policy.
    """

    frames_before: int = 0
    stop: Any = None
    updates: Any = None

    def __call__(self) -> EnvBase:
        """A new environment."""
        if self.stop is not None:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        return super().__call__()

    def extend(self, env: TransformedEnv) -> None:
        """What comes before the cockpit."""
        super().extend(env)
        if self.updates is not None:
            env.append_transform(PolicyVersion(self.updates.get_value))

    def make_cockpit(self) -> Cockpit:
        """One that drives no more than all steps, and ends when the learner ends."""
        return Cockpit(
            self.pace,
            total_steps=self.total_frames,
            steps_before=self.frames_before,
            stop=self.stop,
        )


def _mixed(seed: int, frames: int) -> int:
    """A seed for the part of a run that begins after so many steps."""
    return int(np.random.SeedSequence([seed, frames]).generate_state(1)[0])
