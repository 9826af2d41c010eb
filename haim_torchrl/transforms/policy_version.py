"""Which policy drives, where it is updated while it drives."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from torchrl.data.tensor_specs import Composite, Unbounded
from torchrl.envs import Transform


class PolicyVersion(Transform):
    """Publishes the number of times that the policy was updated, as ``next.policy_version`` [1].

    The root entry of the same name, by which a session tells the version, is the number when the
    step before ended: the policy that chose the action is at least as new. The number under
    ``next`` may be of an update that came after the choice, while the step waited for its time.

    Args:
        count: tells the number; the learner may count it up in another process.
    """

    def __init__(self, count: Callable[[], int]) -> None:
        super().__init__(in_keys=[], out_keys=["policy_version"])
        self.count = count

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """``tensordict`` as it is: without an environment nobody drives."""
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set("policy_version", torch.full((1,), self.count()))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset.set("policy_version", torch.full((1,), self.count()))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entry."""
        observation_spec["policy_version"] = Unbounded(
            shape=(1,), dtype=torch.int64, device=observation_spec.device
        )
        return observation_spec
