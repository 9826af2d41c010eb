"""Loss that tunes the entropy temperature."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from tensordict import NestedKey
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules.temperature import Temperature
from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.term import PolicyTerm


class TemperatureLoss(PolicyTerm):
    r"""Moves α so that the policy's entropy meets a target; leave it out for a fixed α.

    The target −dim(A) is soft actor-critic's rule, and the only reading of the paper's table
    ("target entropy 2.0" for two action dimensions) that squashed actions can meet: their entropy
    is at most log 4 = 1.39 nats.

    Args:
        actor_network: the agent's policy.
        temperature: the temperature that the other terms read.
        target_entropy: in nats, or ``"auto"`` for minus the number of action dimensions.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.

    Raises:
        TypeError: if the temperature is not learnable.
    """

    role: ClassVar[str] = "temperature"

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        temperature: Temperature,
        *,
        target_entropy: float | str = "auto",
        reduction: str | None = None,
    ) -> None:
        super().__init__(reduction=reduction)
        if not isinstance(temperature, Temperature) or not temperature.learnable:
            raise TypeError(
                "temperature must be a learnable Temperature; leave the temperature's loss out "
                "for a fixed one."
            )
        if isinstance(target_entropy, str) and target_entropy != "auto":
            raise ValueError(f"target_entropy must be a number or 'auto', got {target_entropy!r}.")
        self.set_policy(actor_network)
        self.temperature = temperature
        self.target_entropy = target_entropy

    @property
    def loss_name(self) -> str:
        """Name of the entry that holds the loss."""
        return "loss_temperature"

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Computes the loss.

        Args:
            batch: the data and what has been computed from it.

        Returns:
            The loss.
        """
        action, log_prob = self.fresh_action(batch)
        target = self.target_entropy
        target = -float(action.shape[-1]) if isinstance(target, str) else target
        loss = functional.temperature_loss(self.temperature.log_alpha, log_prob, target)
        return {self.loss_name: self._reduce(loss, batch)}

    def reads(self) -> Sequence[NestedKey]:
        """The policy's inputs."""
        return list(self.actor_network.in_keys)

    def trained_parameters(self) -> list[nn.Parameter]:
        """The logarithm of the temperature."""
        return [p for p in self.temperature.parameters()]
