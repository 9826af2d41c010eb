"""Temporal-difference regression of a critic against its own slowly moving target."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ValueEstimators

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.functional import Reduction
from haim_torchrl.objectives.term import CriticTerm, PolicyTerm


class TemporalDifferenceTerm(CriticTerm, PolicyTerm):
    """Base of the losses that regress a critic on a bootstrapped target.

    The target bootstraps on a fresh action of the agent's own policy at the next state, also
    where the mentor drove: the critic values what the agent will do, not what the mentor did.
    An ``n``-step batch (entry ``steps_to_next_obs``) is discounted by γ to the power of n.

    Args:
        actor_network: the agent's policy.
        critic_network: reads observations and an action, writes ``[..., E]`` values.
        label: names the loss ``loss_<label>`` and starts the diagnostics' names.
        actor_weight: signed weight with which :class:`~haim_torchrl.objectives.ActorLoss` takes
            this critic, where it is built from the terms.
        actor_reduction: how the actor's loss reduces the ensemble.
        target_reduction: how the target reduces the ensemble.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @dataclass
    class _AcceptedKeys(CriticTerm._AcceptedKeys):
        terminated: NestedKey = "terminated"
        priority: NestedKey = "td_error"
        steps_to_next_obs: NestedKey = "steps_to_next_obs"

    default_keys = _AcceptedKeys
    default_value_estimator = ValueEstimators.TD0
    _schedulable_buffers = frozenset({"gamma"})

    gamma: Tensor

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        critic_network: TensorDictModule,
        *,
        label: str,
        actor_weight: float,
        actor_reduction: Reduction,
        target_reduction: Reduction,
        reduction: str | None = None,
    ) -> None:
        super().__init__(critic_network, create_target_params=True, reduction=reduction)
        self.set_policy(actor_network)
        for name, value in (("actor", actor_reduction), ("target", target_reduction)):
            if value not in ("min", "max", "mean"):
                raise ValueError(f"{name}_reduction must be 'min', 'max' or 'mean', got {value!r}.")
        self.label = label
        self.actor_weight = float(actor_weight)
        self.actor_reduction = actor_reduction
        self.target_reduction = target_reduction
        self.register_coeff_buffer("gamma", 0.99)

    @property
    def loss_name(self) -> str:
        """Name of the entry that holds the loss."""
        return f"loss_{self.label}"

    @property
    def diagnostics(self) -> list[str]:
        """Mean and size of the values, mean absolute temporal-difference error."""
        return [f"{self.label}_{what}" for what in ("mean", "abs_mean", "abs_max", "td_error")]

    @property
    @abc.abstractmethod
    def action_key(self) -> NestedKey:
        """Entry with the action at which the critic is regressed."""

    @abc.abstractmethod
    def target(
        self, batch: ForwardPass, next_values: Tensor, next_log_prob: Tensor, gamma: Tensor
    ) -> Tensor:
        """The regression target.

        Args:
            batch: the data.
            next_values: target critics at the next state and action, ``[..., E]``.
            next_log_prob: log-density of the next action, ``[..., 1]``.
            gamma: discount, a scalar or ``[..., 1]``.

        Returns:
            Target, ``[..., 1]``.
        """

    def counted(self, batch: ForwardPass) -> Tensor | None:
        """Which transitions the critic is regressed on, bool ``[..., 1]``; None: on all."""
        return None

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Computes the loss and the diagnostics.

        Args:
            batch: the data and what has been computed from it.

        Returns:
            Loss, mean value, mean and largest absolute value, mean absolute error.
        """
        params = self.critic_network_params
        values = batch.stored_values(self.critic, params, self.action_key)
        action, log_prob = self.next_action(batch)
        next_values = batch.next_values(self.critic, self.target_critic_network_params, action)
        target = self.target(batch, next_values, log_prob, self._discount(batch)).detach()
        loss, counted = functional.td_loss(values, target), self.counted(batch)
        if counted is not None:
            loss = loss.masked_fill(~counted, 0.0)
        error = (values.detach() - target).abs().amax(-1)
        self._write_priority(batch.tensordict, error)
        values = values.detach()
        size = values.abs()
        numbers = (values.mean(), size.mean(), size.amax(), error.mean())
        return {
            self.loss_name: self._reduce(loss, batch, mask=counted),
            **dict(zip(self.diagnostics, numbers)),
        }

    def reads(self) -> Sequence[NestedKey]:
        """Observations now and next, the action, the end of the episode."""
        observations = [*self.critic.observation_keys, *self.actor_network.in_keys]
        return [
            *self.critic.observation_keys,
            self.action_key,
            ("next", self.tensor_keys.terminated),
            *[_next(key) for key in observations],
        ]

    def make_value_estimator(
        self, value_type: ValueEstimators | str | None = None, **hyperparams: Any
    ) -> TemporalDifferenceTerm:
        """Sets the discount factor, as with every loss of TorchRL.

        Args:
            value_type: only ``ValueEstimators.TD0``: replayed single transitions carry no
                trajectories. TorchRL's ``MultiStep`` makes n-step transitions of whole ones; name
                every cost in its ``reward_keys``, and use it where episodes do not terminate
                within n steps, since it keeps the first step's ``terminated``.
            **hyperparams: ``gamma``, in [0, 1].

        Returns:
            This loss.

        Raises:
            NotImplementedError: for another estimator.
            TypeError: for another hyper-parameter.
            ValueError: if gamma is outside [0, 1].
        """
        if value_type not in (None, ValueEstimators.TD0, "TD0", "td0"):
            raise NotImplementedError(
                f"{type(self).__name__} supports the value estimator TD0, got {value_type!r}."
            )
        gamma = hyperparams.pop("gamma", None)
        hyperparams.pop("device", None)
        if hyperparams:
            raise TypeError(
                f"make_value_estimator of {type(self).__name__} takes gamma, got "
                f"{sorted(hyperparams)}."
            )
        if gamma is not None:
            if not 0.0 <= float(gamma) <= 1.0:
                raise ValueError(f"gamma must lie in [0, 1], got {gamma}.")
            self.gamma = float(gamma)  # type: ignore[assignment]
        return self

    def _write_priority(self, tensordict: TensorDictBase, error: Tensor) -> None:
        # Data handed over without a tensordict may have been given one dimension more.
        if tensordict.batch_dims > error.ndim:
            error = error.reshape(tensordict.batch_size)
        tensordict.set(self.tensor_keys.priority, error)

    def _discount(self, batch: ForwardPass) -> Tensor:
        steps = batch.tensordict.get(self.tensor_keys.steps_to_next_obs, default=None)
        if steps is None:
            return self.gamma
        return self.gamma ** steps.view_as(batch.read(("next", self.tensor_keys.terminated)))


def _next(key: NestedKey) -> NestedKey:
    return ("next", key) if isinstance(key, str) else ("next", *key)
