"""A mentor made of any trained policy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor
from torch.distributions import TransformedDistribution
from torchrl.envs.utils import ExplorationType, set_exploration_type


class PolicyMentor:
    """Lets a trained TensorDict policy take over.

    The mentor acts deterministically, whatever the exploration type of the collector around it:
    a demonstration should show what the policy knows and not its noise. For the same reason the
    policy is put in evaluation mode.

    Args:
        policy: a ``TensorDictModuleBase`` (an actor, a ``ProbabilisticActor``, ...) or a function
            without arguments that returns one, for instance a ``functools.partial`` that reads a
            checkpoint. The function is called at first use, in the process that needs it.
        action_key: where the policy writes its action.

    Raises:
        TypeError: ``policy`` is neither, or its function returns something else.
        KeyError: the environment does not offer what the policy reads.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from tensordict.nn import TensorDictModule
        >>> actor = TensorDictModule(lambda x: -x[:1], in_keys=["observation"], out_keys=["action"])
        >>> mentor = PolicyMentor(actor)
        >>> mentor.act(None, TensorDict(observation=torch.tensor([0.5, 2.0])))
        tensor([-0.5000])
    """

    def __init__(
        self,
        policy: TensorDictModuleBase | Callable[[], TensorDictModuleBase],
        *,
        action_key: NestedKey = "action",
    ) -> None:
        self._policy: TensorDictModuleBase | None = None
        self._load: Callable[[], TensorDictModuleBase] | None = None
        if isinstance(policy, TensorDictModuleBase):
            self._policy = policy.eval()
        elif callable(policy) and not isinstance(policy, torch.nn.Module):
            self._load = policy
        else:
            raise TypeError(
                f"policy is {type(policy).__name__}: PolicyMentor takes a TensorDict policy, or "
                "a function without arguments that returns one."
            )
        self.action_key = action_key

    @property
    def policy(self) -> TensorDictModuleBase:
        """The policy, loaded at first use."""
        if self._policy is None:
            assert self._load is not None
            policy = self._load()
            if not isinstance(policy, TensorDictModuleBase):
                raise TypeError(
                    f"the mentor's policy loader returned {type(policy).__name__}: it must "
                    "return a TensorDict policy."
                )
            self._policy = policy.eval()
        return self._policy

    def reset(self, simulator: Any) -> None:
        """Nothing to forget."""

    @torch.no_grad()
    def act(self, simulator: Any, tensordict: TensorDictBase) -> Tensor:
        """The policy's deterministic action for ``tensordict``, shape ``[A]``."""
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return self.policy(self._inputs(tensordict)).get(self.action_key)

    @torch.no_grad()
    def density(self, simulator: Any, tensordict: TensorDictBase, action: Tensor) -> float:
        """Density of ``action`` relative to that of the policy's deterministic action.

        A squashed distribution is judged before squashing, where it has one peak: squashing piles
        density up at the bounds, so that a wide policy would seem to like them best.
        """
        get_dist = getattr(self.policy, "get_dist", None)
        if get_dist is None:
            raise TypeError(
                f"the mentor's policy ({type(self.policy).__name__}) has no distribution: use "
                "ProbabilitySwitch(kernel_only=True), which lays a kernel around its action."
            )
        distribution = get_dist(self._inputs(tensordict))
        own = self.act(simulator, tensordict)
        if isinstance(distribution, TransformedDistribution):
            for squash in reversed(distribution.transforms):
                own, action = squash.inv(own), squash.inv(action)
            distribution = distribution.base_dist
        log_ratio = distribution.log_prob(action) - distribution.log_prob(own)
        return math.exp(min(0.0, float(log_ratio.sum())))

    def _inputs(self, tensordict: TensorDictBase) -> TensorDictBase:
        try:
            return tensordict.select(*self.policy.in_keys)
        except KeyError as error:
            raise KeyError(
                f"the mentor's policy reads {list(self.policy.in_keys)}, and the environment "
                f"offers {sorted(map(str, tensordict.keys()))}: use a policy trained on this "
                "observation, or add a transform that makes it."
            ) from error
