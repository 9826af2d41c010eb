"""Collection in other processes of a Ray cluster: on this machine, or on several."""

from __future__ import annotations

import copy
import math
import os
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs.utils import ExplorationType

from haim_torchrl.collectors.acting import as_acting_policy
from haim_torchrl.collectors.mixed_policy import EnvFactory, collected_envs
from haim_torchrl.transforms.keys import InterventionKeys
from haim_torchrl.transforms.transition import TakeoverToTransition

if TYPE_CHECKING:  # importing Ray takes a second, which only its users should pay
    from haim_torchrl.collectors.ray_workers import RayWorkers

LOOPBACK = "127.0.0.1"
OBJECT_STORE = 256 * 2**20
"""Bytes of shared memory of a Ray that is started here; a batch of 100 images takes 10 MiB."""


class ClusterError(RuntimeError):
    """Collecting on the cluster cannot begin or go on; the message says why and what to do."""


def make_ray_collector(
    env_factory: EnvFactory | Sequence[EnvFactory],
    policy: TensorDictModuleBase,
    *,
    frames_per_batch: int,
    total_frames: int = -1,
    num_workers: int = 2,
    address: str | None = None,
    cpus_per_worker: float = 1.0,
    init_random_frames: int = 0,
    seed: int | None = None,
    exploration_type: ExplorationType = ExplorationType.RANDOM,
    postproc: Callable[[TensorDictBase], TensorDictBase] | None = None,
    keys: InterventionKeys | None = None,
    **options: Any,
) -> RayWorkers:
    """:func:`~haim_torchrl.collectors.make_collector`, with its workers in a Ray cluster.

    TorchRL's ``RayCollector`` in its synchronous form: each worker collects its share of a batch
    with the weights that it was sent last, then all wait for the learner. Environments, seeds and
    transitions are those of ``make_collector`` with as many workers, so that both collect the same
    data. Without an ``address`` a Ray of its own is started on this machine: it listens on the
    loopback interface only, has no dashboard, and ends with the collector.

    Args:
        env_factory: builds the environment in the worker, or one factory for each. It is pickled;
            what it imports must be installed wherever a worker may run.
        policy: the agent. Workers act with a copy on their CPU; ``update_policy_weights_()`` sends
            the present weights to all of them.
        frames_per_batch: steps in a batch, over all workers.
        total_frames: steps until the collector stops, -1 for no end.
        num_workers: processes; batches are ``[num_workers, frames_per_batch / num_workers]``.
        address: of a cluster to join, as ``ray.init`` takes it: ``"auto"`` for the one that this
            machine belongs to, or ``"host:6379"``; None starts one here.
        cpus_per_worker: what a worker reserves of the cluster's CPUs.
        init_random_frames: steps of uniform actions at the start.
        seed: seeds simulators and exploration, a stream for each worker.
        exploration_type: how the policy acts; the default is for training.
        postproc: what is done to a batch, by default ``TakeoverToTransition(keys=keys)``.
        keys: names of the entries of the intervention.
        options: further arguments of the ``Collector`` in each worker.

    Returns:
        A ``RayCollector`` with the interface of the other collectors here: ``state_dict`` and
        ``load_state_dict`` for resuming, ``reset``, ``shutdown``.

    Raises:
        ValueError: numbers that do not fit together.
        ClusterError: Ray is not installed, there is no cluster at the address, it has too few
            CPUs, or a worker cannot build its environment.
    """
    if num_workers < 1:
        raise ValueError(f"num_workers is {num_workers}: with Ray there must be at least 1.")
    if cpus_per_worker <= 0.0:
        raise ValueError(f"cpus_per_worker is {cpus_per_worker}: it must be positive.")
    if find_spec("ray") is None:
        raise ClusterError('collector=ray needs Ray: pip install "haim-torchrl[ray]"')
    builders = collected_envs(
        env_factory,
        num_workers,
        frames_per_batch=frames_per_batch,
        total_frames=total_frames,
        init_random_frames=init_random_frames,
        seed=seed,
    )
    from haim_torchrl.collectors.ray_workers import RayWorkers

    acting = as_acting_policy(policy)
    started_here = address is None
    return RayWorkers(
        builders,
        copy.deepcopy(acting).cpu(),
        trained_policy=acting,
        frames_per_batch=frames_per_batch,
        total_frames=sys.maxsize if total_frames < 0 else total_frames,
        init_random_frames=init_random_frames,
        exploration_type=exploration_type,
        postproc=TakeoverToTransition(keys=keys) if postproc is None else postproc,
        collector_kwargs={
            "track_traj_ids": False,
            "auto_register_policy_transforms": False,
            **options,
        },
        ray_init_config=own_ray(num_workers * cpus_per_worker)
        if started_here
        else {
            "address": address,
            "logging_level": "error",
            "log_to_driver": False,
        },
        remote_configs={"num_cpus": cpus_per_worker, "num_gpus": 0},
    )


def own_ray(cpus: float) -> dict[str, Any]:
    """Arguments of ``ray.init`` for a Ray of this run alone, which no other machine can reach.

    Args:
        cpus: what all workers reserve together. Ray offers at least as many, since it would let
            workers wait that have none; they then share those that there are.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # else it reports over the internet
    return {
        "address": "local",  # also where RAY_ADDRESS names a cluster
        "_node_ip_address": LOOPBACK,
        "include_dashboard": False,
        "num_cpus": max(os.cpu_count() or 1, math.ceil(cpus)),
        "num_gpus": 0,
        "object_store_memory": OBJECT_STORE,
        "_system_config": {
            "worker_niceness": 0
        },  # by default anything else on the machine goes first
        "logging_level": "error",
        "log_to_driver": False,
    }
