"""Networks that see: a small convolutional encoder, and the actor and critics around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules.actor import make_actor
from haim_torchrl.modules.critic import make_critic

Shapes = Mapping[str, Sequence[int]]

CHANNELS = (16, 32, 64)
"""Channels of the three layers; sized for two CPU cores."""
WIDTH = 14
"""The first layer makes images of any size about this wide."""


class ImageEncoder(nn.Module):
    """Three convolutions over an image, and numbers beside it.

    The first layer's stride follows the image's size (3 at 42 pixels, 6 at 84; its kernel is twice
    as wide), so that what comes after it costs the same for all: both become 13, 5 and 3 pixels
    wide, and with 64 channels at the end 576 features. Values are read as they are stored, 0 to
    255, and divided by 255 here. The features of an image are brought to mean 0 and variance 1:
    as the convolutions leave them they are about 0.005, and what follows learns slowly from that.

    Args:
        image: shape (C, S, S) of the image.
        numbers: how many numbers stand beside it.
        channels: channels of the three layers.
        device: where to keep the parameters.

    Attributes:
        features: number of features, those of the image first and the numbers after them.

    Raises:
        ValueError: if the image is not square or too small, or there are not three layers.

    Examples:
        >>> encoder = ImageEncoder((5, 42, 42), numbers=1)
        >>> image = torch.zeros(8, 5, 42, 42, dtype=torch.uint8)
        >>> encoder(image, torch.zeros(8, 1)).shape
        torch.Size([8, 577])
    """

    def __init__(
        self,
        image: Sequence[int],
        numbers: int = 0,
        channels: Sequence[int] = CHANNELS,
        *,
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__()
        if len(image) != 3 or image[1] != image[2] or image[1] < WIDTH:
            raise ValueError(
                f"image must be (C, S, S) with S at least {WIDTH}, got {tuple(image)}."
            )
        if len(channels) != 3 or min(channels) < 1:
            raise ValueError(f"channels must be three positive numbers, got {list(channels)}.")
        self.image = tuple(image)
        stride = int(image[1] / WIDTH + 0.5)
        layers: list[nn.Module] = []
        inputs, size = image[0], image[1]
        for outputs, (kernel, step) in zip(channels, ((2 * stride, stride), (4, 2), (3, 1))):
            layers += [nn.Conv2d(inputs, outputs, kernel, step, device=device)]
            layers += [nn.ReLU(inplace=True)]
            inputs, size = outputs, (size - kernel) // step + 1
        seen = inputs * size * size
        norm = nn.LayerNorm(seen, elementwise_affine=False)
        self.layers = nn.Sequential(*layers, nn.Flatten(), norm)
        self.features = seen + numbers

    def forward(self, image: Tensor, *numbers: Tensor) -> Tensor:
        """Features of images.

        Args:
            image: ``[..., C, S, S]``, uint8.
            *numbers: what stands beside it, ``[..., K]`` each.

        Returns:
            Features ``[..., features]``.
        """
        batch = image.shape[:-3]
        pixels = image.reshape(-1, *self.image).to(torch.float32, copy=True).mul_(1.0 / 255.0)
        return torch.cat([self.layers(pixels).reshape(*batch, -1), *numbers], -1)


def make_image_actor(
    shapes: Shapes,
    action_dim: int | None = None,
    hidden: Sequence[int] = (256, 256),
    *,
    channels: Sequence[int] = CHANNELS,
    device: torch.device | str | None = None,
    **options: Any,
) -> ProbabilisticActor:
    """Makes a policy that sees an image and the numbers beside it.

    Its encoder is like any other part of it until :func:`share_encoder` gives it a critic's.

    Args:
        shapes: the observation's entries: one image (C, S, S) and any number of vectors (K,).
        action_dim: size A of the action in [-1, 1].
        hidden: widths of the hidden layers behind the encoder.
        channels: channels of the encoder's layers.
        device: where to keep the parameters.
        **options: further arguments of :func:`~haim_torchrl.modules.make_actor`.

    Returns:
        The policy.

    Raises:
        TypeError: if the observation is one vector.
        ValueError: if there is not exactly one image, or it is too small.

    Examples:
        >>> from tensordict import TensorDict
        >>> actor = make_image_actor({"pixels": (5, 42, 42), "state": (1,)}, action_dim=2)
        >>> seen = {"pixels": torch.zeros(5, 42, 42, dtype=torch.uint8), "state": torch.zeros(1)}
        >>> actor(TensorDict(seen))["action"].shape
        torch.Size([2])
    """
    keys, encoder = _encoder(shapes, channels, device)
    return make_actor(
        encoder.features,
        action_dim,
        hidden,
        encoder=encoder,
        in_keys=keys,
        device=device,
        **options,
    )


def make_image_critic(
    shapes: Shapes,
    action_dim: int,
    hidden: Sequence[int] = (256, 256),
    *,
    channels: Sequence[int] = CHANNELS,
    device: torch.device | str | None = None,
    **options: Any,
) -> TensorDictModule:
    """Makes a twin critic that sees, with an encoder of its own that its members share.

    Args:
        shapes: the observation's entries, as in :func:`make_image_actor`.
        action_dim: size A of the action.
        hidden: widths of the hidden layers behind the encoder.
        channels: channels of the encoder's layers.
        device: where to keep the parameters.
        **options: further arguments of :func:`~haim_torchrl.modules.make_critic`.

    Returns:
        The critic.

    Raises:
        TypeError: if the observation is one vector.
        ValueError: if there is not exactly one image, or it is too small.
    """
    keys, encoder = _encoder(shapes, channels, device)
    return make_critic(
        encoder.features,
        action_dim,
        hidden,
        encoder=encoder,
        in_keys=[*keys, "action"],
        device=device,
        **options,
    )


def encoder_of(network: TensorDictModuleBase) -> ImageEncoder | None:
    """The encoder of an actor or critic; None if it does not see."""
    return next((part for part in network.modules() if isinstance(part, ImageEncoder)), None)


def share_encoder(actor: TensorDictModuleBase, critic: TensorDictModuleBase) -> None:
    """Lets an actor see with a critic's encoder, which no loss of the actor then trains.

    The weights are the same memory: to the critic they are parameters, to the actor buffers, which
    have no gradient and belong to no optimiser. A state dict names them as before. Do this before
    the actor is handed to a loss, and move neither to another device afterwards.

    Args:
        actor: its encoder's parameters are replaced.
        critic: trains its encoder.

    Raises:
        ValueError: if one of them has no encoder, or the two are not alike.
    """
    follower, leader = encoder_of(actor), encoder_of(critic)
    if follower is None or leader is None:
        raise ValueError("an actor and a critic that share an encoder must both have one.")
    weights = dict(leader.named_parameters())
    own = {name: tensor.shape for name, tensor in follower.state_dict().items()}
    if own != {name: tensor.shape for name, tensor in weights.items()}:
        raise ValueError(
            "the actor's encoder differs from the critic's; give both the same channels."
        )
    for name, weight in weights.items():
        path, _, leaf = name.rpartition(".")
        holder = follower.get_submodule(path)
        delattr(holder, leaf)
        holder.register_buffer(leaf, weight.detach())


def _encoder(
    shapes: Shapes, channels: Sequence[int], device: torch.device | str | None
) -> tuple[list[str], ImageEncoder]:
    """The entries in the order that the encoder takes them in, and the encoder."""
    if not isinstance(shapes, Mapping):
        raise TypeError(
            f"The observation is one vector of {shapes} numbers, which these networks for images "
            "cannot read; use env/observation=semantic, or actor=tanh_normal critic=twin."
        )
    images = [key for key, shape in shapes.items() if len(shape) == 3]
    vectors = [key for key, shape in shapes.items() if len(shape) == 1]
    if len(images) != 1 or len(images) + len(vectors) != len(shapes):
        raise ValueError(
            "The observation must have one image [C, S, S], and vectors beside it, got "
            f"{ {key: tuple(shape) for key, shape in shapes.items()} }."
        )
    numbers = sum(shapes[key][0] for key in vectors)
    encoder = ImageEncoder(shapes[images[0]], numbers, channels, device=device)
    return [*images, *vectors], encoder
