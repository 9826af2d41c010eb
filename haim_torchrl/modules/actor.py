"""The agent's stochastic policy: a squashed Gaussian over bounded actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from tensordict import NestedKey
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import Tensor, nn
from torchrl.data import Bounded, TensorSpec
from torchrl.modules import ProbabilisticActor, TanhNormal

from haim_torchrl.modules.critic import RELU, Initialisation, check_vector


class ActorMLP(nn.Module):
    """Perceptron from observations to the mean and spread of a Gaussian.

    The spread is ``softplus(x + c) + minimum_std``, c such that an output of zero means
    ``initial_std``: bounded below, so that log-densities stay finite, and smooth everywhere. (A
    clamped spread or logarithm has no gradient outside its bounds and may stay there.)

    Args:
        observation_dim: size D of the observation, or of the encoder's features.
        action_dim: size A of the action.
        hidden: widths of the hidden layers.
        activation: makes the activation function.
        encoder: maps the observation tensors to features ``[..., D]``.
        initial_std: spread before squashing at an output of zero, > ``minimum_std``.
        minimum_std: lower bound of the spread, > 0.
        initialisation: ``"default"`` is what ``nn.Linear`` draws, ``"orthogonal"`` has a last
            layer a hundred times smaller, so that a new policy is centred.
        device: where to keep the parameters.

    Raises:
        ValueError: if the spreads are not ordered, or the initialisation is unknown.
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        hidden: Sequence[int] = (256, 256),
        *,
        activation: Callable[[], nn.Module] = RELU,
        encoder: nn.Module | None = None,
        initial_std: float = 1.0,
        minimum_std: float = 0.01,
        initialisation: Initialisation = "default",
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__()
        check_vector(observation_dim)
        if not 0.0 < minimum_std < initial_std:
            raise ValueError(
                "minimum_std must be positive and below initial_std, got minimum_std="
                f"{minimum_std} and initial_std={initial_std}."
            )
        if initialisation not in ("default", "orthogonal"):
            raise ValueError(
                f"initialisation must be 'default' or 'orthogonal', got {initialisation!r}."
            )
        self.encoder = encoder
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise((observation_dim, *hidden)):
            layers += [nn.Linear(inputs, outputs, device=device), activation()]
        last = nn.Linear((observation_dim, *hidden)[-1], 2 * action_dim, device=device)
        if initialisation == "orthogonal":
            for layer in (*layers, last):
                if isinstance(layer, nn.Linear):
                    nn.init.orthogonal_(layer.weight, 0.01 if layer is last else math.sqrt(2.0))
                    nn.init.zeros_(layer.bias)
        self.layers = nn.Sequential(*layers, last)
        self.extractor = NormalParamExtractor(
            scale_mapping=f"biased_softplus_{initial_std}_{minimum_std}", scale_lb=minimum_std
        )

    def forward(self, *observations: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and spread, each ``[..., A]``, of the Gaussian before squashing."""
        if self.encoder is not None:
            features = self.encoder(*observations)
        elif len(observations) == 1:
            features = observations[0]
        else:
            features = torch.cat(observations, -1)
        return self.extractor(self.layers(features))


def make_actor(
    observation_dim: int,
    action_dim: int | None = None,
    hidden: Sequence[int] = (256, 256),
    *,
    action_spec: TensorSpec | None = None,
    activation: Callable[[], nn.Module] = RELU,
    encoder: nn.Module | None = None,
    initial_std: float = 1.0,
    minimum_std: float = 0.01,
    initialisation: Initialisation = "default",
    in_keys: Sequence[NestedKey] = ("observation",),
    action_key: NestedKey = "action",
    return_log_prob: bool = False,
    device: torch.device | str | None = None,
) -> ProbabilisticActor:
    """Makes the agent's policy, a tanh-squashed Gaussian (soft actor-critic's).

    It writes its proposal to ``action``; what was executed in its place is the business of the
    environment's intervention transform. Log-densities are not written by default: losses score
    fresh actions themselves, and a collector that does without is lighter.

    Args:
        observation_dim: size D of the observation, or of the encoder's features.
        action_dim: size A of the action in [-1, 1]; or give ``action_spec``.
        hidden: widths of the hidden layers.
        action_spec: bounded spec of the action; its bounds scale the squashed Gaussian.
        activation: makes the activation function.
        encoder: maps the observation tensors to features ``[..., D]``.
        initial_std: spread of a new policy before squashing.
        minimum_std: lower bound of that spread.
        initialisation: ``"default"`` or ``"orthogonal"``.
        in_keys: observation keys.
        action_key: where the action goes.
        return_log_prob: also write the action's log-density.
        device: where to keep the parameters.

    Returns:
        The policy; deterministic under ``ExplorationType.DETERMINISTIC`` (squashed mean).

    Raises:
        ValueError: unless the action's size is given exactly once or twice alike.
        TypeError: if the action spec has no bounds.

    Examples:
        >>> from tensordict import TensorDict
        >>> actor = make_actor(observation_dim=8, action_dim=2)
        >>> actor(TensorDict(observation=torch.zeros(5, 8), batch_size=[5]))["action"].shape
        torch.Size([5, 2])
    """
    spec = _bounded_spec(action_dim, action_spec, device)
    network = ActorMLP(
        observation_dim,
        spec.shape[-1],
        hidden,
        activation=activation,
        encoder=encoder,
        initial_std=initial_std,
        minimum_std=minimum_std,
        initialisation=initialisation,
        device=device,
    )
    low, high = spec.space.low, spec.space.high
    bounds = {} if (low == -1).all() and (high == 1).all() else {"low": low, "high": high}
    return ProbabilisticActor(
        TensorDictModule(network, in_keys=list(in_keys), out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        out_keys=[action_key],
        spec=spec,
        distribution_class=TanhNormal,
        distribution_kwargs=bounds,
        return_log_prob=return_log_prob,
    )


def _bounded_spec(
    action_dim: int | None, action_spec: TensorSpec | None, device: torch.device | str | None
) -> Bounded:
    if action_spec is None:
        if action_dim is None or action_dim < 1:
            raise ValueError(
                f"action_dim must be at least 1, or action_spec be given, got {action_dim}."
            )
        return Bounded(-1.0, 1.0, shape=(action_dim,), dtype=torch.float32, device=device)
    if not isinstance(action_spec, Bounded):
        raise TypeError(
            "action_spec must be a Bounded spec, because the policy squashes its actions into "
            f"bounds, got {type(action_spec).__name__}."
        )
    while action_spec.ndim > 1:
        action_spec = action_spec[0]
    if action_dim is not None and action_spec.shape[-1] != action_dim:
        raise ValueError(
            f"action_dim is {action_dim}, but action_spec has {action_spec.shape[-1]} dimensions; "
            "give one of the two."
        )
    return action_spec
