"""Everything that the terms of one update evaluate, each thing once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar, cast

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictParams
from torch import Tensor

from haim_torchrl.objectives.networks import CriticFunction, PolicyFunction

Result = TypeVar("Result")


class ForwardPass:
    """One batch, and what has been computed from it so far.

    A term that is called alone makes one for itself; the composite makes one for all its terms,
    and then whatever two of them need is computed once: the next action and its log-density
    (three critics), the fresh action (actor and temperature), the embedding of the observation
    (one per critic, for every action that is evaluated on it), the proxy values of the executed
    action (temporal difference and preference).

    Args:
        tensordict: a batch of transitions.
    """

    def __init__(self, tensordict: TensorDictBase) -> None:
        self.tensordict = tensordict
        self._results: dict[Hashable, Any] = {}

    def read(self, key: NestedKey) -> Tensor:
        """An entry of the batch.

        Args:
            key: the entry.

        Returns:
            The entry. (A missing one makes the term fail, which then names it.)
        """
        return self.tensordict.get(key)

    def fresh_action(
        self, policy: PolicyFunction, params: TensorDictParams
    ) -> tuple[Tensor, Tensor]:
        """A new action of the policy at the stored states, with gradient to the policy.

        Args:
            policy: the policy.
            params: its parameters.

        Returns:
            Action ``[..., A]`` and log-density ``[..., 1]``.
        """
        return self._once(
            ("fresh", id(policy.network)), lambda: policy.sample(params, self.tensordict)
        )

    def next_action(
        self, policy: PolicyFunction, params: TensorDictParams
    ) -> tuple[Tensor, Tensor]:
        """A new action of the policy at the next states, without gradient.

        Args:
            policy: the policy.
            params: its parameters.

        Returns:
            Action ``[..., A]`` and log-density ``[..., 1]``.
        """

        def sample() -> tuple[Tensor, Tensor]:
            with torch.no_grad():
                return policy.sample(params, self.tensordict.get("next"))

        return self._once(("next", id(policy.network)), sample)

    def stored_values(
        self, critic: CriticFunction, params: TensorDictParams, key: NestedKey
    ) -> Tensor:
        """Values of a stored action, with gradient to the critic.

        Args:
            critic: the critic.
            params: its parameters.
            key: where the action is stored.

        Returns:
            Values, ``[..., E]``.
        """

        def values() -> Tensor:
            embedding = self._embedding(critic, params)
            return critic.values(params, embedding, self.read(key))

        return self._once(("stored", id(critic.network), key), values)

    def values(
        self,
        critic: CriticFunction,
        params: TensorDictParams,
        action: Tensor,
        *,
        detach: bool = False,
    ) -> Tensor:
        """Values of an action at the stored states, with gradient to the action.

        Args:
            critic: the critic.
            params: its parameters.
            action: ``[..., A]``.
            detach: whether to keep the gradient from the critic.

        Returns:
            Values, ``[..., E]``.
        """
        return critic.values(params, self._embedding(critic, params), action, detach=detach)

    def next_values(
        self, critic: CriticFunction, params: TensorDictParams, action: Tensor
    ) -> Tensor:
        """Values of an action at the next states, without any gradient.

        Args:
            critic: the critic.
            params: its target parameters.
            action: ``[..., A]``.

        Returns:
            Values, ``[..., E]``.
        """
        with torch.no_grad():
            embedding = critic.embed(params, self.tensordict.get("next"))
            return critic.values(params, embedding, action)

    def _embedding(self, critic: CriticFunction, params: TensorDictParams) -> Any:
        return self._once(
            ("embedding", id(critic.network)), lambda: critic.embed(params, self.tensordict)
        )

    def _once(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        if key not in self._results:
            self._results[key] = compute()
        return cast(Result, self._results[key])
