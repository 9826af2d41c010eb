"""A penalty for leaving the policy that drove the batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from tensordict import NestedKey
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.on_policy.functional import gaussian_kl
from haim_torchrl.objectives.term import PolicyTerm, parameters_of


class PolicyDivergenceLoss(PolicyTerm):
    r"""The divergence from the policy that drove, :math:`c \, KL(\pi_{old} \| \pi)`.

    TorchRL has either the clipped objective or the penalty. The paper's table has both, as RLlib's
    PPO does. The divergence is exact, and the coefficient stays as it is.

    Args:
        actor_network: the policy, a squashed Gaussian.
        coefficient: c, positive.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
    """

    @dataclass
    class _AcceptedKeys(PolicyTerm._AcceptedKeys):
        loc: NestedKey = "loc"
        scale: NestedKey = "scale"

    default_keys = _AcceptedKeys
    role: ClassVar[str] = "actor"

    def __init__(
        self,
        actor_network: ProbabilisticActor,
        coefficient: float,
        *,
        reduction: str | None = None,
    ) -> None:
        super().__init__(reduction=reduction)
        self.coefficient = coefficient
        self.set_policy(actor_network)

    @property
    def loss_name(self) -> str:
        """``loss_divergence``."""
        return "loss_divergence"

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """The penalty.

        Args:
            batch: the data, with ``loc`` and ``scale`` of the policy that drove.

        Returns:
            The loss.
        """
        seen = batch.tensordict.select(*self.actor_network.in_keys)
        seen.batch_size = []
        new = self._policy.run(self.actor_network_params, self.actor_network.get_dist_params, seen)
        old = batch.read(self.tensor_keys.loc), batch.read(self.tensor_keys.scale)
        divergence = gaussian_kl(*old, new.get("loc"), new.get("scale"))
        return {"loss_divergence": self._reduce(self.coefficient * divergence, batch)}

    def reads(self) -> Sequence[NestedKey]:
        """The observations, and mean and spread of the policy that drove."""
        return [*self.actor_network.in_keys, self.tensor_keys.loc, self.tensor_keys.scale]

    def trained_parameters(self) -> list[nn.Parameter]:
        """The policy's parameters."""
        return parameters_of(self.actor_network_params)
