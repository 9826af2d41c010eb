"""Who did this: a network that tells an expert's action from a policy's."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.modules import MLP

from haim_torchrl.modules.critic import check_vector


def make_discriminator(
    observation_dim: int,
    action_dim: int,
    hidden: Sequence[int] = (256, 256),
    *,
    activation: Callable[[], nn.Module] = nn.Tanh,
    in_keys: Sequence[NestedKey] = ("observation", "action"),
    logits_key: NestedKey = "logits",
    probability_key: NestedKey = "d_logits",
    device: torch.device | str | None = None,
) -> TensorDictSequential:
    """Makes a discriminator as a tensordict module.

    Args:
        observation_dim: size D of the observation.
        action_dim: size A of the action.
        hidden: widths of the hidden layers.
        activation: makes the activation function.
        in_keys: observation keys, then the action key.
        logits_key: where the log-odds ``[..., 1]`` of the expert go.
        probability_key: where the expert's probability ``[..., 1]`` goes; the default is what
            TorchRL's ``GAILLoss`` reads as a probability by default, whatever it is called.
        device: where to keep the parameters.

    Returns:
        The network.

    Raises:
        TypeError: if the observation is the shapes of several entries.

    Examples:
        >>> from tensordict import TensorDict
        >>> discriminator = make_discriminator(8, 2)
        >>> pairs = TensorDict(observation=torch.zeros(5, 8), action=torch.zeros(5, 2))
        >>> discriminator(pairs)["logits"].shape
        torch.Size([5, 1])
    """
    check_vector(observation_dim)
    network = MLP(
        in_features=observation_dim + action_dim,
        out_features=1,
        num_cells=list(hidden),
        activation_class=activation,
        device=device,
    )
    return TensorDictSequential(
        TensorDictModule(network, in_keys=list(in_keys), out_keys=[logits_key]),
        TensorDictModule(nn.Sigmoid(), in_keys=[logits_key], out_keys=[probability_key]),
    )
