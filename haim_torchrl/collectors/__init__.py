"""Collection of transitions by agent and mentor together."""

from haim_torchrl.collectors.acting import ActingPolicy, as_acting_policy
from haim_torchrl.collectors.cluster import ClusterError, make_ray_collector
from haim_torchrl.collectors.live import LiveCollector, LiveCollectorError
from haim_torchrl.collectors.mixed_policy import (
    EnvFactory,
    make_collector,
    resume_collector,
    shutting_down,
)

__all__ = [
    "ActingPolicy",
    "ClusterError",
    "EnvFactory",
    "LiveCollector",
    "LiveCollectorError",
    "as_acting_policy",
    "make_collector",
    "make_ray_collector",
    "resume_collector",
    "shutting_down",
]
