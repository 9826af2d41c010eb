"""Behaviour cloning of an ensemble."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictParams
from torch import Tensor, nn

from haim_torchrl.objectives import functional
from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.networks import FunctionalNetwork
from haim_torchrl.objectives.term import LossTerm, parameters_of


class EnsembleCloningLoss(LossTerm):
    """Draws each member of an ensemble to the recorded action, as if it were trained alone.

    TorchRL's ``BCLoss`` (of which it is the ``l2`` loss, for several members at once) clones one
    policy. Samples that are to count more have a weight in ``priority_weight``.

    Args:
        actor_network: writes the members' actions ``[..., E, A]``; see
            :func:`~haim_torchrl.modules.make_ensemble_actor`.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from haim_torchrl.modules import make_ensemble_actor
        >>> loss = EnsembleCloningLoss(make_ensemble_actor(3, 2))
        >>> data = {"observation": torch.zeros(4, 3), "action": torch.zeros(4, 2)}
        >>> sorted(loss(TensorDict(data, batch_size=[4])).keys())
        ['doubt', 'loss_cloning']
    """

    @dataclass
    class _AcceptedKeys(LossTerm._AcceptedKeys):
        action: NestedKey = "action"
        action_members: NestedKey = "action_members"
        doubt: NestedKey = "doubt"

    default_keys = _AcceptedKeys
    role: ClassVar[str] = "actor"

    actor_network: TensorDictModule
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init__(self, actor_network: TensorDictModule, *, reduction: str | None = None) -> None:
        super().__init__(reduction=reduction)
        self.convert_to_functional(actor_network, "actor_network")
        self._actor = FunctionalNetwork(self.actor_network, self.actor_network_params)

    @property
    def loss_name(self) -> str:
        """Name of the entry that holds the loss."""
        return "loss_cloning"

    @property
    def diagnostics(self) -> list[str]:
        """The mean doubt at the samples."""
        return ["doubt"]

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """Computes the loss.

        Args:
            batch: the data.

        Returns:
            The loss, and the mean doubt.

        Raises:
            ValueError: if the policy does not write what its members do.
        """
        keys, written = self.tensor_keys, list(self.actor_network.out_keys)
        for key in (keys.action_members, keys.doubt):
            if key not in written:
                raise ValueError(
                    f"actor_network writes {written}, but not {key!r}; use make_ensemble_actor, or "
                    "name another entry with set_keys()."
                )
        seen = batch.tensordict.select(*self.actor_network.in_keys)
        done = self._actor.run(self.actor_network_params, self.actor_network, seen)
        action = batch.read(keys.action)
        distance = functional.ensemble_distance(done.get(keys.action_members), action)
        doubt = done.get(keys.doubt).mean()
        return {self.loss_name: self._reduce(distance, batch), "doubt": doubt.detach()}

    def reads(self) -> Sequence[NestedKey]:
        """The policy's inputs and the recorded action."""
        return [*self.actor_network.in_keys, self.tensor_keys.action]

    def trained_parameters(self) -> list[nn.Parameter]:
        """Those of all members."""
        return parameters_of(self.actor_network_params)
