"""Anchor of the policy at the mentor's actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from tensordict import NestedKey
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.term import PolicyTerm, parameters_of


class CloningAnchorLoss(PolicyTerm):
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
    class _AcceptedKeys(PolicyTerm._AcceptedKeys):
        action_mentor: NestedKey = "action"
        intervention: NestedKey = "intervention"

    default_keys = _AcceptedKeys
    _schedulable_buffers = frozenset({"weight"})
    role: ClassVar[str] = "actor"

    weight: Tensor

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        *,
        weight: float = 1.0,
        reduction: str | None = None,
    ) -> None:
        super().__init__(reduction=reduction)
        self.set_policy(actor_network)
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
        action, _ = self.fresh_action(batch)
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
