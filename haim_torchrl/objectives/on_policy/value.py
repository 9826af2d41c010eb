"""Regression of a state value on its target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictParams
from torch import Tensor, nn

from haim_torchrl.objectives.forward_pass import ForwardPass
from haim_torchrl.objectives.networks import FunctionalNetwork
from haim_torchrl.objectives.term import LossTerm, parameters_of


class StateValueLoss(LossTerm):
    r"""Half the squared distance of a state's value from its target, :math:`\frac12 (V(s) - y)^2`.

    TorchRL's PPO losses train one value beside the policy. Constrained methods have a second one,
    for the cost, and constrained policy optimisation trains its policy by no loss at all.

    Args:
        value_network: reads observations, writes ``[..., 1]``.
        name: of the loss, ``loss_<name>``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from haim_torchrl.modules import make_value
        >>> loss = StateValueLoss(make_value(3, hidden=(8,)))
        >>> batch = TensorDict(observation=torch.zeros(4, 3), value_target=torch.zeros(4, 1))
        >>> sorted(loss(batch).keys())
        ['loss_value']
    """

    @dataclass
    class _AcceptedKeys(LossTerm._AcceptedKeys):
        value: NestedKey = "state_value"
        value_target: NestedKey = "value_target"

    default_keys = _AcceptedKeys

    value_network: TensorDictModule
    value_network_params: TensorDictParams
    target_value_network_params: TensorDictParams

    def __init__(
        self,
        value_network: TensorDictModule,
        *,
        name: str = "value",
        reduction: str | None = None,
    ) -> None:
        super().__init__(reduction=reduction)
        self._name = name
        self.convert_to_functional(value_network, "value_network")
        self._function = FunctionalNetwork(self.value_network, self.value_network_params)

    @property
    def loss_name(self) -> str:
        """``loss_<name>``."""
        return f"loss_{self._name}"

    def evaluate(self, batch: ForwardPass) -> dict[str, Tensor]:
        """The loss.

        Args:
            batch: the data.

        Returns:
            The loss under :attr:`loss_name`.
        """
        seen = batch.tensordict.select(*self.value_network.in_keys)
        seen.batch_size = []
        written = self._function.run(self.value_network_params, self.value_network, seen)
        error = written.get(self.tensor_keys.value) - batch.read(self.tensor_keys.value_target)
        return {self.loss_name: self._reduce(0.5 * error.square(), batch)}

    def reads(self) -> Sequence[NestedKey]:
        """The observations and the target."""
        return [*self.value_network.in_keys, self.tensor_keys.value_target]

    def trained_parameters(self) -> list[nn.Parameter]:
        """The value's parameters."""
        return parameters_of(self.value_network_params)
