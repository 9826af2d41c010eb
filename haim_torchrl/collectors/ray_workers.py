"""TorchRL's Ray collector, completed: weights by the object store, resuming, orderly ends."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from typing import Any

import ray
from ray._private import ray_constants
from ray.exceptions import GetTimeoutError, RayError
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector
from torchrl.collectors.distributed import RayCollector

from haim_torchrl.collectors.cluster import ClusterError
from haim_torchrl.collectors.mixed_policy import CollectedEnv

RAISED = re.compile(r"[\w.]*(Error|Exception): ")
"""How the last part of a traceback begins."""
CLOSING = 10.0
"""Seconds that workers have for closing their environments."""


class WorkerCollector(Collector):
    """The collector inside a worker.

    Ray asks an actor that failed whether it is true. For a ``Collector`` that is a matter of its
    length, which one without end does not have, and what had failed would be lost.
    """

    def __bool__(self) -> bool:
        """Yes."""
        return True


class RayWorkers(RayCollector):
    """A synchronous ``RayCollector`` that can be resumed and says in a sentence what went wrong.

    Use :func:`~haim_torchrl.collectors.make_ray_collector`, which fills in the arguments. What
    differs from TorchRL's class:

    - Weights travel through Ray's object store. TorchRL's own way opens a second connection to
      an address found by the host's name, which on many machines is a loopback address that
      others cannot reach.
    - ``state_dict`` also holds the steps so far, ``reset`` exists, and iterating sends the weights.
    - Environments are closed before the workers end.
    - :class:`~haim_torchrl.collectors.ClusterError` takes the place of Ray's tracebacks.

    Args:
        builders: one for each worker.
        policy: the copy that workers start from, on the CPU.
        trained_policy: whose weights are sent.
        arguments: further ones of ``RayCollector``.

    Raises:
        ClusterError: there is no cluster, it has too few CPUs, or an environment cannot be built.
    """

    def __init__(
        self,
        builders: Sequence[CollectedEnv],
        policy: TensorDictModuleBase,
        *,
        trained_policy: TensorDictModuleBase,
        **arguments: Any,
    ) -> None:
        self._ends_ray = not ray.is_initialized()
        try:
            wanted = len(builders) * arguments["remote_configs"]["num_cpus"]
            _connect(arguments["ray_init_config"], wanted)
            with _in_a_sentence():
                super().__init__(
                    list(builders),
                    policy,
                    collector_class=WorkerCollector,
                    sync=True,
                    weight_sync_schemes={},
                    **arguments,
                )
            self._weight_sync_initialized = True  # what iterator() below does
            self._trained_policy = trained_policy
            self._on_workers("__ray_ready__")
        except BaseException:
            if self._ends_ray:
                ray.shutdown()
            raise

    def iterator(self) -> Iterator[TensorDictBase]:
        """Batches ``[workers, T]``, the first of them with the policy's present weights.

        Raises:
            ClusterError: If a worker failed or was lost.
        """
        self.update_policy_weights_()
        with _in_a_sentence():
            yield from super().iterator()

    def update_policy_weights_(self, *args: Any, **kwargs: Any) -> None:
        """Let all workers act with the policy's present weights.

        Args:
            args: a policy or weights to send instead, as TorchRL's collectors take them.
            kwargs: further arguments of TorchRL's method.

        Raises:
            ClusterError: If a worker was lost.
        """
        if not args:
            weights = TensorDict.from_module(self._trained_policy).data.cpu()
            args = (ray.put(weights),)
        self._on_workers("update_policy_weights_", *args, **kwargs)

    def reset(self) -> None:
        """Begin a new episode in each worker."""
        self._on_workers("reset")

    def state_dict(self) -> dict[str, Any]:
        """Steps so far, and the state of each worker with its random numbers."""
        return {"frames": self.collected_frames, "workers": self._on_workers("state_dict")}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on from it.

        Raises:
            ClusterError: If it is of another number of workers.
        """
        states = state_dict.get("workers", [])
        if len(states) != self.num_collectors:
            raise ClusterError(
                f"the run was saved with {len(states)} Ray workers and collector.num_workers is "
                f"{self.num_collectors}: use collector.num_workers={len(states)}"
            )
        with _in_a_sentence():
            ray.get([w.load_state_dict.remote(s) for w, s in zip(self.remote_collectors, states)])
        self.collected_frames = int(state_dict["frames"])

    def shutdown(self, timeout: float | None = None, shutdown_ray: bool = False) -> None:
        """Close the environments and end the workers, and Ray if it was started for them."""
        if self.remote_collectors and ray.is_initialized():
            wait = CLOSING if timeout is None else timeout
            with contextlib.suppress(RayError, GetTimeoutError):
                ray.get([w.shutdown.remote() for w in self.remote_collectors], timeout=wait)
        super().shutdown(timeout, shutdown_ray=shutdown_ray)
        if self._ends_ray and ray.is_initialized():
            self._ends_ray = False
            ray.shutdown()

    def _on_workers(self, method: str, *args: Any, **kwargs: Any) -> list[Any]:
        with _in_a_sentence():
            return ray.get(
                [getattr(w, method).remote(*args, **kwargs) for w in self.remote_collectors]
            )


def _connect(config: dict[str, Any], cpus: float) -> None:
    """Start or join a cluster, unless this process belongs to one already."""
    if not ray.is_initialized():
        try:
            with _loopback(config["address"] == "local"):
                ray.init(**config)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise ClusterError(
                f"no Ray cluster at collector.address={config['address']}: {_sentence(error)}; "
                "start one with `ray start --head`, or leave collector.address=null"
            ) from error
    has = ray.cluster_resources().get("CPU", 0.0)
    if has < cpus:
        raise ClusterError(
            f"the Ray cluster has {has:g} CPUs and collector.num_workers with "
            f"collector.cpus_per_worker asks for {cpus:g}: lower one of them"
        )


@contextlib.contextmanager
def _loopback(wanted: bool) -> Iterator[None]:
    """Let Ray stay on 127.0.0.1, which on Linux it otherwise replaces by an outer address."""
    former = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = former and not wanted
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = former


@contextlib.contextmanager
def _in_a_sentence() -> Iterator[None]:
    try:
        yield
    except RayError as error:
        raise ClusterError(f"a Ray worker failed: {_sentence(error)}") from error


def _sentence(error: BaseException) -> str:
    """What went wrong: the exception in the worker if there was one, else Ray's own first line."""
    cause = getattr(error, "cause", None)
    if isinstance(cause, BaseException):
        return " ".join(str(cause).split()) or type(cause).__name__
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if lines and "creation task" in lines[0]:  # a traceback follows, its exception comes last
        last = max(i for i, line in enumerate(lines) if i == 0 or RAISED.match(line))
        lines = [" ".join(lines[last:])]
    return lines[0].rstrip(".") if lines else type(error).__name__
