"""Networks called with parameters given at each call: online, target, or detached ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar, runtime_checkable

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictParams
from torch import Tensor, nn
from torch.compiler import is_compiling
from torchrl.modules import ProbabilisticActor
from torchrl.modules.distributions.utils import rsample_and_log_prob

Result = TypeVar("Result")


class FunctionalNetwork:
    """Runs a network with parameters handed over at the call.

    Does what ``params.to_module(network)`` does, at a twentieth of its cost: the places that hold
    the parameters are looked up once, and each call only exchanges the tensors in them. An update
    of three critics calls networks some fifteen times, where that difference shows.

    Args:
        network: a module.
        params: its parameters as ``LossModule.convert_to_functional`` made them.
    """

    def __init__(self, network: nn.Module, params: TensorDictParams) -> None:
        self.network = network
        self._names = leaf_names(params)
        self._places = [_find(network, name) for name in self._names]

    def run(
        self,
        params: TensorDictParams,
        function: Callable[..., Result],
        *args: Any,
        detach: bool = False,
    ) -> Result:
        """Calls ``function(*args)`` while the network holds ``params``.

        Args:
            params: parameters with the keys of those given to the constructor.
            function: something that uses the network.
            *args: passed on.
            detach: cut the parameters from the graph: the gradient passes through the network to
                its inputs, and never reaches its parameters.

        Returns:
            What the function returns.
        """
        if is_compiling():
            held = params.detach() if detach else params
            with held.to_module(self.network, preserve_module_state=False):
                return function(*args)
        tensors = leaves(params, self._names)
        if detach:
            tensors = [tensor.detach() for tensor in tensors]
        before = [holder[name] for holder, name in self._places]
        try:
            for (holder, name), tensor in zip(self._places, tensors):
                holder[name] = tensor
            return function(*args)
        finally:
            for (holder, name), tensor in zip(self._places, before):
                holder[name] = tensor


def leaf_names(params: TensorDictParams) -> list[str]:
    """Dotted names of all tensors of a module's parameters, in a fixed order."""
    return [key if isinstance(key, str) else ".".join(key) for key in params.keys(True, True)]


def leaves(params: TensorDictParams, names: Sequence[str]) -> list[Tensor]:
    """The tensors of these names.

    ``TensorDictParams`` registers its leaves by dotted name like any module does; reading them
    there costs a hundredth of walking the tensordict.
    """
    parameters, buffers = params._parameters, params._buffers
    return [parameters[name] if name in parameters else buffers[name] for name in names]


def _find(network: nn.Module, name: str) -> tuple[dict[str, Any], str]:
    path, _, name = name.rpartition(".")
    holder = network.get_submodule(path)
    return (holder._parameters if name in holder._parameters else holder._buffers), name


def _inputs(tensordict: TensorDictBase, keys: Sequence[NestedKey]) -> TensorDictBase:
    """What a network reads, in a tensordict of its own that it may write to.

    Without batch dimensions: those of the data are not always known (a call without a tensordict
    guesses them), and a network does not need them.
    """
    data = tensordict.select(*keys)
    data.batch_size = []
    return data


class PolicyFunction(FunctionalNetwork):
    """A stochastic policy as a function of parameters and data."""

    network: ProbabilisticActor

    def sample(self, params: TensorDictParams, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Draws a reparametrised action and its log-density from the same draw.

        Args:
            params: parameters of the policy.
            tensordict: holds the policy's inputs; it is not written to.

        Returns:
            Action ``[..., A]`` and log-density in nats ``[..., 1]``.
        """
        return self.run(params, self._sample, tensordict)

    def _sample(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        data = _inputs(tensordict, self.network.in_keys)
        action, log_prob = rsample_and_log_prob(self.network.get_dist(data))
        if log_prob.ndim < action.ndim:
            log_prob = log_prob.unsqueeze(-1)
        return action, log_prob


@runtime_checkable
class SplitsObservation(Protocol):
    """A critic network that can do its observation part once for several actions."""

    def embed(self, *observations: Tensor) -> Tensor:
        """Observation part."""

    def evaluate(self, embedding: Tensor, action: Tensor) -> Tensor:
        """Values ``[..., E]`` of actions ``[..., A]``."""


class CriticFunction(FunctionalNetwork):
    """Any tensordict critic as a function of parameters, data and action.

    Its embedding is simply its inputs other than the action; see :class:`SplitCriticFunction`.

    Args:
        network: reads observations and an action, writes ``[..., E]`` values.
        params: its parameters.
        action_key: entry that the network reads as the action.
        value_key: entry that it writes.

    Raises:
        ValueError: if the network does not read or write these entries.
    """

    network: TensorDictModule

    def __init__(
        self,
        network: TensorDictModule,
        params: TensorDictParams,
        *,
        action_key: NestedKey,
        value_key: NestedKey,
    ) -> None:
        if action_key not in network.in_keys or value_key not in network.out_keys:
            raise ValueError(
                f"The critic reads {list(network.in_keys)} and writes {list(network.out_keys)}, "
                f"but the loss expects it to read the action at {action_key!r} and to write "
                f"values at {value_key!r}; rename one with set_keys(action=..., "
                "state_action_value=...) or in the critic."
            )
        super().__init__(network, params)
        self.action_key = action_key
        self.value_key = value_key
        self.observation_keys = [key for key in network.in_keys if key != action_key]

    def embed(self, params: TensorDictParams, tensordict: TensorDictBase) -> Any:
        """What :meth:`values` needs of the data besides the action."""
        return _inputs(tensordict, self.observation_keys)

    def values(
        self, params: TensorDictParams, embedding: Any, action: Tensor, *, detach: bool = False
    ) -> Tensor:
        """Values of actions, ``[..., E]``.

        Args:
            params: parameters of the critic.
            embedding: result of :meth:`embed` for the same parameters.
            action: ``[..., A]``.
            detach: let the gradient reach the action alone.

        Returns:
            Values, ``[..., E]``.
        """
        if detach:
            embedding = embedding.detach()
        return self.run(params, self._values, embedding, action, detach=detach)

    def _values(self, embedding: Any, action: Tensor) -> Tensor:
        data = embedding.copy().set(self.action_key, action)
        return self.network(data).get(self.value_key)


class SplitCriticFunction(CriticFunction):
    """A critic whose network can embed the observation once for several actions."""

    def embed(self, params: TensorDictParams, tensordict: TensorDictBase) -> Any:
        """The network's own embedding of the observations."""
        observations: Sequence[Tensor] = [tensordict.get(key) for key in self.observation_keys]
        return self.run(params, self.network.module.embed, *observations)

    def _values(self, embedding: Any, action: Tensor) -> Tensor:
        return self.network.module.evaluate(embedding, action)


def critic_function(
    network: TensorDictModule,
    params: TensorDictParams,
    *,
    action_key: NestedKey,
    value_key: NestedKey,
) -> CriticFunction:
    """Picks the cheapest way of evaluating a critic.

    Args:
        network: the critic.
        params: its parameters.
        action_key: entry that the critic reads as the action.
        value_key: entry that it writes.

    Returns:
        The critic as a function. It splits the work if the network offers to and reads the action
        last, as those of ``make_critic`` do.
    """
    splits = isinstance(getattr(network, "module", None), SplitsObservation)
    last = bool(network.in_keys) and network.in_keys[-1] == action_key
    kind = SplitCriticFunction if splits and last else CriticFunction
    return kind(network, params, action_key=action_key, value_key=value_key)
