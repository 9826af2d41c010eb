"""Anchor of the policy at the mentor's actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictParams
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.term import LossTerm, parameters_of, policy_function


class CloningAnchorLoss(LossTerm):
    """Draws the policy towards the mentor's action where the mentor drove.

    Preferences pin the proxy values at two actions of a state only. Between and beyond them a
    policy that climbs the values' gradient can run the wrong way: one that had been corrected at
    the road's edge by full steering to the right steered to the left of its own rejected action.
    The anchor tells it the direction. It is no part of the paper; leave it out for the paper's
    method.

    Args:
        actor_network: the agent's policy.
        weight: weight of the term.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @dataclass
    class _AcceptedKeys(LossTerm._AcceptedKeys):
        action_mentor: NestedKey = "action"
        intervention: NestedKey = "intervention"

    default_keys = _AcceptedKeys
    _schedulable_buffers = frozenset({"weight"})
    role: ClassVar[str] = "actor"

    actor_network: TensorDictModule
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams
    weight: Tensor

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        *,
        weight: float = 1.0,
        reduction: str | None = None,
    ) -> None:
        super().__init__(reduction=reduction)
        self.convert_to_functional(actor_network, "actor_network")
        self._policy = policy_function(self)
        self.register_coeff_buffer("weight", float(weight))

    @property
    def loss_name(self) -> str:
        """Name of the entry that holds the loss."""
        return "loss_anchor"

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Computes the loss.

        Args:
            batch: the data and what has been computed from it.

        Returns:
            The loss.
        """
        action, _ = batch.fresh_action(self._policy, self.actor_network_params)
        distance = functional.anchor_distance(
            action,
            batch.read(self.tensor_keys.action_mentor),
            batch.read(self.tensor_keys.intervention),
        )
        return {self.loss_name: self._reduce(self.weight * distance, batch)}

    def reads(self) -> Sequence[NestedKey]:
        """The policy's inputs, the mentor's action, and who drove."""
        keys = self.tensor_keys
        return [*self.actor_network.in_keys, keys.action_mentor, keys.intervention]

    def trained_parameters(self) -> list[nn.Parameter]:
        """The policy's parameters."""
        return parameters_of(self.actor_network_params)
