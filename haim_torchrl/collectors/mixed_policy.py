"""Collects transitions of agent and mentor driving together."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TypeAlias

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import BaseCollector, Collector, MultiSyncCollector
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import ExplorationType

from haim_torchrl.collectors.acting import as_acting_policy
from haim_torchrl.human.cockpit import Cockpit
from haim_torchrl.transforms.keys import InterventionKeys
from haim_torchrl.transforms.random_state import SimulatorRandomState
from haim_torchrl.transforms.transition import TakeoverToTransition

EnvFactory: TypeAlias = Callable[[], EnvBase]
"""Builds an environment with its own intervention transform, where it will run."""

DeviceLike: TypeAlias = torch.device | str | int


def make_collector(
    env_factory: EnvFactory | Sequence[EnvFactory],
    policy: TensorDictModuleBase,
    *,
    frames_per_batch: int,
    total_frames: int = -1,
    num_workers: int = 0,
    init_random_frames: int = 0,
    seed: int | None = None,
    pace: float | None = None,
    device: DeviceLike | None = None,
    storing_device: DeviceLike | None = None,
    exploration_type: ExplorationType = ExplorationType.RANDOM,
    postproc: Callable[[TensorDictBase], TensorDictBase] | None = None,
    keys: InterventionKeys | None = None,
    **options: Any,
) -> BaseCollector:
    """TorchRL's collector for a mixed behaviour policy: every transition says who drove.

    The agent proposes, the environment's
    :class:`~haim_torchrl.transforms.InterventionTransform` decides and may replace the action, and
    :class:`~haim_torchrl.transforms.TakeoverToTransition` makes the documented transition of each
    step. Because the mentor sits in the environment it also protects, and is recorded in, the
    random frames at the start, which never pass through the policy.

    The agent explores (acts at random around its mean) whatever an evaluation in the same thread
    did before, as TorchRL's collectors set the exploration type for each batch. That setting is
    one for the whole process: an evaluation in *another thread* of this process, such as TorchRL's
    ``Evaluator`` with ``trigger_eval``, makes part of the training data deterministic. Evaluate
    between batches or in another process.

    Args:
        env_factory: builds the environment; or one factory for each worker. With workers it must
            be importable or a closure that pickles, and scripts need a ``__main__`` guard. An
            environment that is not batched gets a
            :class:`~haim_torchrl.transforms.SimulatorRandomState`.
        policy: the agent. A plain squashed Gaussian is run in its lean form
            (:func:`~haim_torchrl.collectors.as_acting_policy`). With ``num_workers=0`` and one
            device training it changes what is collected next; in any case call
            ``collector.update_policy_weights_()`` after an update, which copies where it must.
        frames_per_batch: steps in a batch, over all workers.
        total_frames: steps until the collector stops, -1 for no end.
        num_workers: 0 collects in this process, batches ``[T]``; n collects in n others at once,
            batches ``[n, T / n]``. (One environment for each process: for simulators in Python
            that is faster than a ``ParallelEnv``.)
        init_random_frames: steps of uniform actions at the start.
        seed: seeds the simulators, a different stream for each worker, and torch in the workers;
            torch in this process is the caller's to seed.
        pace: steps per second, held by a :class:`~haim_torchrl.human.Cockpit`; by default it
            drives as fast as it goes.
        device: where the policy acts, by default the CPU whatever device it is trained on: for
            one observation at a time a small network is fastest there. A copy is made if needed.
        storing_device: where batches are put; by default they stay on the CPU.
        exploration_type: how the policy acts; the default is for training.
        postproc: what is done to a batch, by default ``TakeoverToTransition(keys=keys)``.
        keys: names of the entries of the intervention.
        options: further arguments of ``Collector`` or ``MultiSyncCollector``.

    Returns:
        A ``Collector``, or a ``MultiSyncCollector`` for ``num_workers >= 1``.

    Raises:
        ValueError: numbers that do not fit together.

    Examples:
        >>> from torchrl.envs import GymEnv
        >>> from haim_torchrl.mentors import FunctionMentor
        >>> from haim_torchrl.modules import make_actor
        >>> from haim_torchrl.switches import Always
        >>> from haim_torchrl.transforms import InterventionTransform
        >>> def mentor():
        ...     return FunctionMentor(lambda simulator, tensordict: [0.0])
        >>> def make_env():
        ...     takeover = InterventionTransform(mentor, Always())
        ...     return TransformedEnv(GymEnv("Pendulum-v1"), takeover)
        >>> actor = make_actor(3, action_spec=make_env().action_spec)
        >>> collector = make_collector(make_env, actor, frames_per_batch=10, total_frames=20)
        >>> [int(batch["intervention"].sum()) for batch in collector]
        [10, 10]
    """
    builders = collected_envs(
        env_factory,
        num_workers,
        frames_per_batch=frames_per_batch,
        total_frames=total_frames,
        init_random_frames=init_random_frames,
        seed=seed,
        pace=pace,
    )
    arguments: dict[str, Any] = {
        "frames_per_batch": frames_per_batch,
        "total_frames": total_frames,
        "init_random_frames": init_random_frames,
        "storing_device": storing_device,
        "exploration_type": exploration_type,
        "postproc": TakeoverToTransition(keys=keys) if postproc is None else postproc,
        "auto_register_policy_transforms": False,
        **options,
    }
    acting = as_acting_policy(policy)
    collector: BaseCollector
    if num_workers == 0:
        # Numbering the trajectories costs a tenth of the collector's time; replay of single
        # transitions has no use for it.
        arguments.setdefault("track_traj_ids", False)
        env = builders[0]()
        arguments.setdefault("policy_device", _acting_device(policy, device, env.device))
        collector = Collector(env, acting, **arguments)
    else:
        arguments.setdefault("cat_results", "stack")
        arguments.setdefault("policy_device", _acting_device(policy, device, None))
        collector = MultiSyncCollector(builders, acting, **arguments)
    collector._trained_policy = acting  # a collector holds what it copies weights from weakly
    return collector


def collected_envs(
    env_factory: EnvFactory | Sequence[EnvFactory],
    workers: int,
    *,
    frames_per_batch: int,
    total_frames: int = -1,
    init_random_frames: int = 0,
    seed: int | None = None,
    pace: float | None = None,
) -> list[CollectedEnv]:
    """What each collecting process builds its environment with.

    The streams of seeds depend on nothing but ``seed`` and the number of environments, so that it
    makes no difference to the data where the processes run.

    Args:
        env_factory: builds the bare environment; or one factory for each worker.
        workers: processes beside this one; 0 for one environment in this process.
        frames_per_batch: steps in a batch, over all of them.
        total_frames: steps until the collector stops, -1 for no end.
        init_random_frames: steps of uniform actions at the start.
        seed: seeds all of them, each with a stream of its own; None leaves them unseeded.
        pace: steps per second; None drives as fast as it goes.

    Raises:
        ValueError: numbers that do not fit together.
    """
    factories = _factories(env_factory, workers)
    if frames_per_batch < 1 or frames_per_batch % len(factories):
        raise ValueError(
            f"frames_per_batch is {frames_per_batch}: it must be a positive multiple of the "
            f"{len(factories)} environments that collect at once."
        )
    if 0 <= total_frames < init_random_frames:
        raise ValueError(
            f"init_random_frames is {init_random_frames}, more than total_frames {total_frames}: "
            "the agent would never act."
        )
    seeds = np.random.SeedSequence(seed).spawn(len(factories)) if seed is not None else None
    return [
        CollectedEnv(
            factory,
            seed=None if seeds is None else int(seeds[index].generate_state(1)[0]),
            in_worker=workers > 0,
            pace=pace,
            total_frames=total_frames,
        )
        for index, factory in enumerate(factories)
    ]


@contextmanager
def shutting_down(collector: Resumable) -> Iterator[None]:
    """Shut a collector down however the block ends, or its processes would outlive it."""
    try:
        yield
    finally:
        collector.shutdown()


class Resumable(Protocol):
    """A collector as far as going on from a checkpoint needs it."""

    def load_state_dict(self, state_dict: Any) -> Any:
        """Take over what was saved."""
        ...

    def reset(self) -> Any:
        """Begin new episodes."""
        ...

    def shutdown(self) -> Any:
        """End its processes and close its environments."""
        ...


def resume_collector(collector: Resumable, state: dict[str, Any]) -> None:
    """Continue collecting where ``state = collector.state_dict()`` was saved.

    Restores the counts of frames, the policy's weights and the random state of the simulators,
    and starts the episode that would have come next: simulators cannot save the middle of one.

    Args:
        collector: made as the saved one was.
        state: what ``state_dict`` returned.
    """
    collector.load_state_dict(state)
    collector.reset()


class CollectedEnv:
    """Builds an environment as collectors drive it: seeded, resumable, and paced if wanted.

    Args:
        factory: builds the bare one.
        seed: of the simulator, and of torch where the environment runs in a worker.
        in_worker: whether it will run in a process of its own.
        pace: steps per second; None drives as fast as it goes, without a cockpit.
        total_frames: steps of the whole run, for what a person is shown.
    """

    def __init__(
        self,
        factory: EnvFactory,
        seed: int | None,
        in_worker: bool,
        *,
        pace: float | None = None,
        total_frames: int = 0,
    ) -> None:
        self.factory = factory
        self.seed = seed
        self.in_worker = in_worker
        self.pace = pace
        self.total_frames = max(total_frames, 0)

    def __call__(self) -> EnvBase:
        """A new environment."""
        env = self.factory()
        if not env.batch_size:
            if not isinstance(env, TransformedEnv):
                env = TransformedEnv(env)
            self.extend(env)
            cockpit = self.make_cockpit()
            if cockpit is not None:
                env.append_transform(cockpit)
        if self.seed is not None:
            env.set_seed(self.seed)
            if self.in_worker:
                torch.manual_seed(self.seed)
        return env

    def extend(self, env: TransformedEnv) -> None:
        """What comes before the cockpit."""
        env.append_transform(SimulatorRandomState(with_torch=self.in_worker))

    def make_cockpit(self) -> Cockpit | None:
        """What holds the pace and serves the person."""
        return None if self.pace is None else Cockpit(self.pace, total_steps=self.total_frames)


def _acting_device(
    policy: TensorDictModuleBase,
    device: DeviceLike | None,
    env_device: torch.device | None,
) -> torch.device | None:
    """Device to pass on: the environment's if all is there, since casts cost a step 0.1 ms."""
    wanted = torch.device("cpu" if device is None else device)
    present = {parameter.device for parameter in policy.parameters()}
    if wanted.type == "cpu" and present <= {wanted}:
        return wanted if env_device == wanted else None
    return wanted


def _factories(env_factory: EnvFactory | Sequence[EnvFactory], workers: int) -> list[EnvFactory]:
    if workers < 0:
        raise ValueError(f"num_workers is {workers}: give 0 for this process, or a number.")
    count = max(1, workers)
    if callable(env_factory):
        return [env_factory] * count
    factories = list(env_factory)
    if len(factories) != count:
        raise ValueError(
            f"{len(factories)} environment factories for {count} collecting processes: give one "
            "for each, or a single one for all."
        )
    return factories
