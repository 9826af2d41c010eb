"""What all loss terms have in common."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictParams, dispatch
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import LossModule

from haim_torchrl.modules.temperature import Temperature
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.networks import CriticFunction, PolicyFunction, critic_function


class LossTerm(LossModule):
    """One term of the objective: a TorchRL loss module that can also share a forward pass.

    Called with a batch it works alone, like any loss of TorchRL. The composite instead calls
    :meth:`evaluate` of each of its terms with one common forward pass. A term of one's own
    defines :meth:`evaluate`, :attr:`loss_name`, :attr:`role` and what it reads.

    Args:
        reduction: ``"mean"`` (default), ``"sum"`` or ``"none"`` (one number per transition).

    Raises:
        ValueError: if the reduction is unknown.
    """

    @dataclass
    class _AcceptedKeys:
        priority_weight: NestedKey = "priority_weight"

    default_keys: type = _AcceptedKeys
    tensor_keys: Any

    #: Fresh actions are drawn, never the mode. (The flag is global to the process: the default of
    #: ``LossModule`` would make the actions of a collector in another thread deterministic.)
    deterministic_sampling_mode = ExplorationType.RANDOM

    #: Group of parameters that this term trains: their learning rate can be set apart.
    role: ClassVar[str] = "critic"

    def __init__(self, *, reduction: str | None = None) -> None:
        super().__init__()
        if reduction not in (None, "mean", "sum", "none"):
            raise ValueError(f"reduction must be 'mean', 'sum' or 'none', got {reduction!r}.")
        self.reduction = reduction or "mean"
        self._in_keys: list[NestedKey] | None = None
        self._out_keys: list[NestedKey] | None = None

    @property
    @abc.abstractmethod
    def loss_name(self) -> str:
        """Name of the entry that holds the loss, starting with ``loss_``."""

    @property
    def diagnostics(self) -> list[str]:
        """Names of the further entries: scalars without gradient, for the log."""
        return []

    @abc.abstractmethod
    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Computes the loss and the diagnostics.

        Args:
            batch: the data and what has been computed from it.

        Returns:
            An entry for each of :attr:`out_keys`.
        """

    @abc.abstractmethod
    def reads(self) -> Sequence[NestedKey]:
        """Entries of the batch that the term reads."""

    @abc.abstractmethod
    def trained_parameters(self) -> list[nn.Parameter]:
        """The parameters that this term's gradient reaches: these and no others."""

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Computes the loss of a batch.

        Args:
            tensordict: a batch of transitions.

        Returns:
            The loss and the diagnostics.
        """
        result = TensorDict(self.compute(ForwardPass(tensordict)))
        self._clear_weakrefs(tensordict, result, *self._parameter_names())
        return result

    def compute(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Does :meth:`evaluate`, and explains a failure for want of an entry.

        Args:
            batch: the data and what has been computed from it.

        Returns:
            An entry for each of :attr:`out_keys`.

        Raises:
            KeyError: if the batch lacks an entry, or the result has other entries than announced;
                the message names the term and the entry.
        """
        try:
            result = self.evaluate(batch)
        except (AttributeError, KeyError, RuntimeError, TypeError) as error:
            for key in self.in_keys:
                if batch.tensordict.get(key, default=None) is None:
                    raise KeyError(
                        f"{type(self).__name__} needs the entry {key!r}, which the batch lacks; "
                        f"it has {sorted(map(str, batch.tensordict.keys(True, True)))}. Record "
                        "it, or name another one with set_keys()."
                    ) from error
            raise
        if list(result) != (announced := [self.loss_name, *self.diagnostics]):
            raise KeyError(
                f"{type(self).__name__}.evaluate returned {list(result)}, but its loss_name and "
                f"diagnostics announce {announced}: give both the same names, in the same order."
            )
        return result

    @property
    def in_keys(self) -> list[NestedKey]:
        """Entries of the batch that the term reads, each once."""
        if self._in_keys is None:
            self._in_keys = list(dict.fromkeys(self.reads()))
        return self._in_keys

    @in_keys.setter
    def in_keys(self, keys: list[NestedKey]) -> None:
        self._in_keys = keys

    @property
    def out_keys(self) -> list[NestedKey]:
        """Entries of the result: the loss, then the diagnostics."""
        if self._out_keys is None:
            self._out_keys = [self.loss_name, *self.diagnostics]
        return self._out_keys

    @out_keys.setter
    def out_keys(self, keys: list[NestedKey]) -> None:
        self._out_keys = keys

    def reset_parameters_recursive(self) -> None:
        """Draws the parameters anew; targets become copies, a temperature its start value."""
        super().reset_parameters_recursive()
        self.synchronise_targets()
        for child in self.children():
            if isinstance(child, Temperature):
                child.reset_parameters()

    def synchronise_targets(self) -> None:
        """Makes the targets copies of what they follow."""
        for name in self._parameter_names():
            if name.startswith("target_"):
                self._modules[name].data.update_(self._modules[name[len("target_") :]].data)

    def _reduce(self, loss: Tensor, batch: ForwardPass, *, mask: Tensor | None = None) -> Tensor:
        """Reduces ``[..., 1]``, honouring masks and priority weights found in the batch.

        A mean is taken over ``mask`` alone; outside of it the loss must be zero already.
        """
        data = batch.tensordict
        mask = mask if self.reduction == "mean" else None
        weights = self._maybe_get_priority_weight(data)
        return self._reduce_loss(loss.squeeze(-1), data, mask=mask, weights=weights)

    def _parameter_names(self) -> list[str]:
        return [n for n, m in self._modules.items() if isinstance(m, TensorDictParams)]

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        self._in_keys = None


class CriticTerm(LossTerm):
    """A term that evaluates a critic.

    Args:
        critic_network: reads observations and an action, writes ``[..., E]`` values.
        create_target_params: keep a slowly moving copy of its parameters.
        reduction: see :class:`LossTerm`.
    """

    @dataclass
    class _AcceptedKeys(LossTerm._AcceptedKeys):
        action: NestedKey = "action"
        state_action_value: NestedKey = "state_action_value"

    default_keys = _AcceptedKeys

    critic_network: TensorDictModule
    critic_network_params: TensorDictParams
    target_critic_network_params: TensorDictParams

    def __init__(
        self,
        critic_network: TensorDictModule,
        *,
        create_target_params: bool = False,
        reduction: str | None = None,
    ) -> None:
        super().__init__(reduction=reduction)
        self.convert_to_functional(
            critic_network, "critic_network", create_target_params=create_target_params
        )
        self._critic: CriticFunction | None = None

    @property
    def critic(self) -> CriticFunction:
        """The critic as a function of parameters, data and action."""
        if self._critic is None:
            self._critic = critic_function(
                self.critic_network,
                self.critic_network_params,
                action_key=self.tensor_keys.action,
                value_key=self.tensor_keys.state_action_value,
            )
        return self._critic

    def trained_parameters(self) -> list[nn.Parameter]:
        """The critic's parameters."""
        return parameters_of(self.critic_network_params)

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        super()._forward_value_estimator_keys(**kwargs)
        self._critic = None


class PolicyTerm(LossTerm):
    """A term that draws actions of the agent's policy; hand it over with :meth:`set_policy`."""

    actor_network: TensorDictModule
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams
    _policy: PolicyFunction

    def set_policy(self, actor_network: ProbabilisticActor) -> None:
        """Makes the policy part of the term, to be called in the constructor.

        Args:
            actor_network: the agent's policy.
        """
        self.convert_to_functional(actor_network, "actor_network")
        self._policy = PolicyFunction(self.actor_network, self.actor_network_params)

    def fresh_action(self, batch: ForwardPass) -> tuple[Tensor, Tensor]:
        """The policy's action at the stored states, the same for all terms of an update.

        Args:
            batch: the data.

        Returns:
            Action ``[..., A]``, with gradient to the policy, and log-density ``[..., 1]``.
        """
        return batch.fresh_action(self._policy, self.actor_network_params)

    def next_action(self, batch: ForwardPass) -> tuple[Tensor, Tensor]:
        """The policy's action at the next states, without gradient.

        Args:
            batch: the data.

        Returns:
            Action ``[..., A]`` and log-density ``[..., 1]``.
        """
        return batch.next_action(self._policy, self.actor_network_params)


def parameters_of(params: TensorDictParams) -> list[nn.Parameter]:
    """Leaves that are trainable parameters (and not buffers).

    Args:
        params: parameters as ``convert_to_functional`` made them.

    Returns:
        The parameters.
    """
    return [leaf for leaf in params.values(True, True) if isinstance(leaf, nn.Parameter)]
