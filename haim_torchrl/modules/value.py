"""State values: what a policy expects from a state on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import NestedKey
from torch import nn
from torchrl.modules import MLP, ValueOperator

from haim_torchrl.modules.critic import check_vector


def make_value(
    observation_dim: int,
    hidden: Sequence[int] = (256, 256),
    *,
    activation: Callable[[], nn.Module] = nn.Tanh,
    in_keys: Sequence[NestedKey] = ("observation",),
    out_key: NestedKey = "state_value",
    device: torch.device | str | None = None,
) -> ValueOperator:
    """Makes a state-value network as a tensordict module.

    Args:
        observation_dim: size D of the observation.
        hidden: widths of the hidden layers.
        activation: makes the activation function.
        in_keys: observation keys, joined to ``[..., D]``.
        out_key: where the value ``[..., 1]`` goes.
        device: where to keep the parameters.

    Returns:
        The network.

    Raises:
        TypeError: if the observation is the shapes of several entries.

    Examples:
        >>> from tensordict import TensorDict
        >>> value = make_value(8, out_key="cost_value")
        >>> value(TensorDict(observation=torch.zeros(5, 8), batch_size=[5]))["cost_value"].shape
        torch.Size([5, 1])
    """
    check_vector(observation_dim)
    network = MLP(
        in_features=observation_dim,
        out_features=1,
        num_cells=list(hidden),
        activation_class=activation,
        device=device,
    )
    return ValueOperator(network, in_keys=list(in_keys), out_keys=[out_key])
