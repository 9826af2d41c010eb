"""The policy's loss (eq 25)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from tensordict import NestedKey, TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules.temperature import Temperature, as_temperature
from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.functional import Reduction
from haim_torchrl.objectives.networks import CriticFunction, critic_function
from haim_torchrl.objectives.term import PolicyTerm, parameters_of


class WeightedCritic(NamedTuple):
    """A critic as the actor's objective sees it.

    Attributes:
        network: the critic.
        weight: signed: positive is maximised, negative minimised.
        reduction: how to reduce its ensemble.
    """

    network: TensorDictModule
    weight: float = 1.0
    reduction: Reduction = "min"


class ActorLoss(PolicyTerm):
    r"""Maximises the weighted critics and the entropy (eq 25).

    .. math:: -[\psi \min Q - \alpha \log\pi(a|s) - \beta \max Q^{EX} - \varphi \max Q^{IM}]

    The action is a fresh draw at the stored state. Critics are read with detached parameters: the
    gradient passes through them to the action and never reaches them. A critic left out is a
    term left out. The weights are buffers ``weight_<name>`` that can be scheduled.

    Args:
        actor_network: the agent's policy.
        critics: by name, each a :class:`WeightedCritic` or such a tuple.
        temperature: entropy temperature α, shared with the other terms, or a constant.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.

    Raises:
        ValueError: if there is no critic, or a reduction is unknown.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from haim_torchrl.modules import make_actor, make_critic
        >>> critics = {
        ...     "proxy": (make_critic(3, 2), 1.0, "min"),
        ...     "explicit": (make_critic(3, 2), -1.0, "max"),
        ... }
        >>> loss = ActorLoss(make_actor(3, 2), critics, temperature=0.1)
        >>> sorted(loss(TensorDict(observation=torch.zeros(4, 3), batch_size=[4])).keys())
        ['actor_explicit', 'actor_proxy', 'alpha', 'entropy', 'loss_actor']
    """

    @dataclass
    class _AcceptedKeys(PolicyTerm._AcceptedKeys):
        action: NestedKey = "action"
        state_action_value: NestedKey = "state_action_value"

    default_keys = _AcceptedKeys
    role: ClassVar[str] = "actor"

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        critics: Mapping[str, WeightedCritic | tuple[TensorDictModule, float, Reduction]],
        temperature: Temperature | float = 1.0,
        *,
        reduction: str | None = None,
    ) -> None:
        super().__init__(reduction=reduction)
        if not critics:
            raise ValueError("critics must name at least one critic for the actor to follow.")
        self.set_policy(actor_network)
        self.temperature = as_temperature(temperature)
        self._readings: dict[str, tuple[TensorDictModule, Reduction]] = {}
        for name, critic in critics.items():
            network, weight, how = critic
            if how not in ("min", "max", "mean"):
                raise ValueError(
                    f"The reduction of critic {name!r} must be 'min', 'max' or 'mean', got {how!r}."
                )
            self._readings[name] = (network, how)
            params = TensorDict.from_module(network, as_module=True)
            self.add_module(f"{name}_critic_params", params)
            self.register_coeff_buffer(f"weight_{name}", float(weight))
        self._functions: dict[str, CriticFunction] = {}

    @property
    def loss_name(self) -> str:
        """Name of the entry that holds the loss."""
        return "loss_actor"

    @property
    def diagnostics(self) -> list[str]:
        """Temperature, entropy (in nats), and each critic's mean at the fresh actions."""
        return ["alpha", "entropy", *[f"actor_{name}" for name in self._readings]]

    def critic(self, name: str) -> CriticFunction:
        """One of the critics as a function of parameters, data and action."""
        if name not in self._functions:
            self._functions[name] = critic_function(
                self._readings[name][0],
                self._modules[f"{name}_critic_params"],
                action_key=self.tensor_keys.action,
                value_key=self.tensor_keys.state_action_value,
            )
        return self._functions[name]

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Computes the loss and the diagnostics.

        Args:
            batch: the data and what has been computed from it.

        Returns:
            Loss, temperature, entropy, and each critic's mean value.
        """
        action, log_prob = self.fresh_action(batch)
        alpha = self.temperature()
        weighted: list[tuple[Tensor, Tensor]] = []
        means: dict[str, Tensor] = {}
        for name, (_, reduction) in self._readings.items():
            params = self._modules[f"{name}_critic_params"]
            values = batch.values(self.critic(name), params, action, detach=True)
            value = functional.reduce_ensemble(values, reduction)
            weighted.append((self._buffers[f"weight_{name}"], value))
            means[f"actor_{name}"] = value.detach().mean()
        objective = functional.actor_objective(log_prob, weighted, alpha)
        return {
            self.loss_name: self._reduce(-objective, batch),
            "alpha": alpha,
            "entropy": -log_prob.detach().mean(),
            **means,
        }

    def reads(self) -> Sequence[NestedKey]:
        """Inputs of the policy and of the critics, without the action."""
        keys = list(self.actor_network.in_keys)
        for name in self._readings:
            keys += self.critic(name).observation_keys
        return keys

    def trained_parameters(self) -> list[nn.Parameter]:
        """The policy's parameters."""
        return parameters_of(self.actor_network_params)

    def _forward_value_estimator_keys(self, **kwargs: Any) -> None:
        super()._forward_value_estimator_keys(**kwargs)
        self._functions = {}
