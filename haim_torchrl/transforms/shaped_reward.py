"""The environment's reward less the weighed cost, for the baselines that learn from both."""

from __future__ import annotations

import math

from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite
from torchrl.envs import Transform

from haim_torchrl.objectives import functional

_NO_STEP = (
    "ShapedReward needs finished steps, with an entry 'next': make it the postproc of a collector "
    "or a transform of a replay buffer, not of an environment."
)


class ShapedReward(Transform):
    """Writes ``shaped_reward`` beside the reward of collected steps.

    The reward itself stays as it is: it is what a return is measured by. Use it as ``postproc`` of
    a collector, as a transform of a replay buffer (it acts on ``extend``), or call it. Any batch
    shape; the input is not modified.

    Args:
        cost_weight: reward that a cost of 1 takes away, ≥ 0; 0 leaves the reward alone.
        reward: entry under ``next`` with the reward.
        cost: entry under ``next`` with the cost.
        out: entry under ``next`` that is written.

    Raises:
        ValueError: If the weight is negative or not finite.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> step = {"reward": torch.tensor([[1.5]]), "cost": torch.tensor([[1.0]])}
        >>> ShapedReward(5.0)(TensorDict(next=step, batch_size=[1]))["next", "shaped_reward"]
        tensor([[-3.5000]])
    """

    def __init__(
        self,
        cost_weight: float,
        *,
        reward: NestedKey = "reward",
        cost: NestedKey = "cost",
        out: NestedKey = "shaped_reward",
    ) -> None:
        if not 0.0 <= cost_weight < math.inf:
            raise ValueError(f"cost_weight must be a number of at least 0, got {cost_weight}.")
        super().__init__(in_keys=[], out_keys=[])
        self.cost_weight = float(cost_weight)
        self.reward, self.cost, self.out = reward, cost, out

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Transitions with the shaped reward.

        Args:
            tensordict: finished steps, with ``next``.

        Returns:
            The same, and the shaped reward.

        Raises:
            KeyError: If the steps lack the reward or the cost.
        """
        return self._inv_call(tensordict)

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        """Refuses an environment, whose steps are not finished when they pass here."""
        raise RuntimeError(_NO_STEP)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        following = tensordict.get("next", None)
        if following is None:
            raise KeyError(_NO_STEP)
        for key in (self.reward, self.cost):
            if following.get(key, None) is None:
                raise KeyError(
                    f"The environment writes no entry {key!r}, which reward shaping needs; name "
                    "another one, or use a method that learns without reward."
                )
        reward, cost = following.get(self.reward), following.get(self.cost)
        shaped = functional.shaped_reward(reward, cost.to(reward.dtype), self.cost_weight)
        return tensordict.copy().set("next", following.copy().set(self.out, shaped))
