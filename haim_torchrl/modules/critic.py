"""Action-value critics: an ensemble of independent networks evaluated together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.nn import functional as F

Initialisation = Literal["default", "orthogonal"]

#: In place: nothing else holds the pre-activations, and a batch of them is as large as a layer.
RELU = partial(nn.ReLU, inplace=True)


def check_vector(observation_dim: Any) -> None:
    """Refuses, in a sentence, an observation that is not one vector.

    Raises:
        TypeError: if it is the shapes of several entries.
    """
    if isinstance(observation_dim, Mapping):
        raise TypeError(
            f"The observation has the entries {', '.join(observation_dim)}, and these networks "
            "read one vector; use those for images (actor=cnn critic=cnn), which recipes/haim.py "
            "has, or observe numbers (env/observation=numeric)."
        )


class EnsembleMLP(nn.Module):
    """``E`` independent multi-layer perceptrons Q_e(s, a), evaluated together.

    The first layer is split into the part that reads the observation and the part that reads the
    action. One update evaluates the same critic at the same states for several actions (executed,
    proposed, fresh); :meth:`embed` does the large product with the observation once, and
    :meth:`evaluate` finishes for each action. The members' later layers are batched matrix
    products, so that there is neither a Python loop over the members nor a ``vmap``.

    Args:
        observation_dim: size D of the observation, or of the encoder's features.
        action_dim: size A of the action.
        hidden: widths of the hidden layers, at least one.
        ensemble_size: number of members E; 2 are the twins of clipped double Q-learning.
        activation: makes the activation function.
        layer_norm: normalise each hidden layer of each member before its activation. It bounds
            how far a critic can extrapolate to unseen actions.
        encoder: maps the observation tensors to features ``[..., D]``, shared by the members.
        initialisation: ``"default"`` draws what ``nn.Linear`` draws, ``"orthogonal"`` orthogonal
            weights and zero biases; each member is drawn independently.
        device: where to keep the parameters.

    Raises:
        ValueError: if a size is not positive or the initialisation is unknown.

    Examples:
        >>> critic = EnsembleMLP(observation_dim=8, action_dim=2)
        >>> critic(torch.zeros(5, 8), torch.zeros(5, 2)).shape
        torch.Size([5, 2])
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        hidden: Sequence[int] = (256, 256),
        *,
        ensemble_size: int = 2,
        activation: Callable[[], nn.Module] = RELU,
        layer_norm: bool = False,
        encoder: nn.Module | None = None,
        initialisation: Initialisation = "default",
        device: torch.device | str | None = None,
    ) -> None:
        super().__init__()
        check_vector(observation_dim)
        sizes = (observation_dim, action_dim, ensemble_size, *hidden)
        if not hidden or min(sizes) < 1:
            raise ValueError(
                "observation_dim, action_dim, ensemble_size and every width in hidden must be at "
                f"least 1, and hidden not empty; got {observation_dim}, {action_dim}, "
                f"{ensemble_size} and {tuple(hidden)}."
            )
        if initialisation not in ("default", "orthogonal"):
            raise ValueError(
                f"initialisation must be 'default' or 'orthogonal', got {initialisation!r}."
            )
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self.ensemble_size = ensemble_size
        self.initialisation = initialisation
        self.encoder = encoder
        self.activation = activation()

        def parameter(*shape: int) -> nn.Parameter:
            return nn.Parameter(torch.empty(*shape, device=device))

        members, first = ensemble_size, hidden[0]
        self.observation_weight = parameter(members * first, observation_dim)
        self.action_weight = parameter(members * first, action_dim)
        self.input_bias = parameter(members * first)
        widths = (*hidden, 1)
        self.weights = nn.ParameterList(
            parameter(members, inputs, outputs) for inputs, outputs in pairwise(widths)
        )
        self.biases = nn.ParameterList(parameter(members, 1, outputs) for outputs in widths[1:])
        norms: list[nn.Module] = [nn.Identity() for _ in hidden]
        if layer_norm:
            # The first layer lies member by member within a row: its groups are the members.
            norms = [nn.GroupNorm(members, members * first, device=device)]
            norms += [EnsembleLayerNorm(members, width, device=device) for width in hidden[1:]]
        self.norms = nn.ModuleList(norms)
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Draws all parameters of the perceptrons anew (the encoder is left alone)."""
        with torch.no_grad():
            first = self.observation_weight.shape[0] // self.ensemble_size
            inputs = self.observation_dim + self.action_dim
            for member in range(self.ensemble_size):
                rows = slice(member * first, (member + 1) * first)
                weight, bias = self._draw(inputs, first, gain=math.sqrt(2.0))
                self.observation_weight[rows] = weight[:, : self.observation_dim]
                self.action_weight[rows] = weight[:, self.observation_dim :]
                self.input_bias[rows] = bias
                for layer, (weights, biases) in enumerate(zip(self.weights, self.biases)):
                    last = layer == len(self.weights) - 1
                    weight, bias = self._draw(
                        weights.shape[1], weights.shape[2], gain=1.0 if last else math.sqrt(2.0)
                    )
                    weights[member] = weight.T
                    biases[member, 0] = bias

    def _draw(self, inputs: int, outputs: int, *, gain: float) -> tuple[Tensor, Tensor]:
        layer = nn.Linear(inputs, outputs)
        if self.initialisation == "orthogonal":
            nn.init.orthogonal_(layer.weight, gain)
            nn.init.zeros_(layer.bias)
        return layer.weight, layer.bias

    def embed(self, *observations: Tensor) -> Tensor:
        """The observation's part of the first layer, reusable for any number of actions.

        Args:
            *observations: what the encoder reads; without an encoder, tensors ``[..., d_i]`` that
                are joined to ``[..., D]``.

        Returns:
            Embedding, ``[..., E * hidden[0]]``.
        """
        if self.encoder is not None:
            features = self.encoder(*observations)
        elif len(observations) == 1:
            features = observations[0]
        else:
            features = torch.cat(observations, -1)
        return F.linear(features, self.observation_weight)

    def evaluate(self, embedding: Tensor, action: Tensor) -> Tensor:
        """Values of actions at states embedded by :meth:`embed`.

        Args:
            embedding: ``[..., E * hidden[0]]``.
            action: ``[..., A]``.

        Returns:
            Values, ``[..., E]``.
        """
        batch = embedding.shape[:-1]
        # Biases are added in place: a product with a bias first copies that into its result.
        hidden = torch.addmm(
            embedding.reshape(-1, embedding.shape[-1]),
            action.reshape(-1, self.action_dim),
            self.action_weight.T,
        ).add_(self.input_bias)
        first, *later = self.norms
        # Activate first, where memory is contiguous, and only then put the members first.
        hidden = self.activation(first(hidden))
        hidden = hidden.unflatten(-1, (self.ensemble_size, -1)).transpose(0, 1)
        for norm, weight, bias in zip(later, self.weights, self.biases):
            hidden = self.activation(norm(torch.bmm(hidden, weight).add_(bias)))
        values = torch.baddbmm(self.biases[-1], hidden, self.weights[-1])
        return values.squeeze(-1).T.reshape(*batch, self.ensemble_size)

    def forward(self, *inputs: Tensor) -> Tensor:
        """Values of state-action pairs.

        Args:
            *inputs: the observation tensors, then the action ``[..., A]``.

        Returns:
            Values, ``[..., E]``.
        """
        *observations, action = inputs
        return self.evaluate(self.embed(*observations), action)


class EnsembleLayerNorm(nn.Module):
    """Layer normalisation with a scale and shift of its own for each member.

    Args:
        ensemble_size: number of members E.
        width: number of features H.
        device: where to keep the parameters.
    """

    def __init__(
        self, ensemble_size: int, width: int, *, device: torch.device | str | None = None
    ) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(ensemble_size, 1, width, device=device))
        self.bias = nn.Parameter(torch.empty(ensemble_size, 1, width, device=device))
        self.reset_parameters()

    def reset_parameters(self) -> None:
        """Sets scale 1 and shift 0."""
        nn.init.ones_(self.weight)
        nn.init.zeros_(self.bias)

    def forward(self, hidden: Tensor) -> Tensor:
        """Normalises ``[E, N, H]`` over its last dimension."""
        return torch.addcmul(self.bias, F.layer_norm(hidden, hidden.shape[-1:]), self.weight)


def make_critic(
    observation_dim: int,
    action_dim: int,
    hidden: Sequence[int] = (256, 256),
    *,
    ensemble_size: int = 2,
    activation: Callable[[], nn.Module] = RELU,
    layer_norm: bool = False,
    encoder: nn.Module | None = None,
    initialisation: Initialisation = "default",
    in_keys: Sequence[NestedKey] = ("observation", "action"),
    out_key: NestedKey = "state_action_value",
    device: torch.device | str | None = None,
) -> TensorDictModule:
    """Makes a twin (or larger) critic as a tensordict module.

    All members are one module that writes them to the last dimension of one entry: the losses of
    this package reduce that dimension, and one product serves all members.

    Args:
        observation_dim: size D of the observation, or of the encoder's features.
        action_dim: size A of the action.
        hidden: widths of the hidden layers.
        ensemble_size: number of members E.
        activation: makes the activation function.
        layer_norm: normalise hidden layers.
        encoder: maps the observation tensors to features ``[..., D]``. Give each network an
            encoder of its own, else one loss moves what another one stands on.
        initialisation: ``"default"`` or ``"orthogonal"``.
        in_keys: observation keys, then the action key.
        out_key: where the values ``[..., E]`` go.
        device: where to keep the parameters.

    Returns:
        The critic.

    Examples:
        >>> from tensordict import TensorDict
        >>> critic = make_critic(observation_dim=8, action_dim=2)
        >>> data = TensorDict(observation=torch.zeros(5, 8), action=torch.zeros(5, 2))
        >>> critic(data)["state_action_value"].shape
        torch.Size([5, 2])
    """
    network = EnsembleMLP(
        observation_dim,
        action_dim,
        hidden,
        ensemble_size=ensemble_size,
        activation=activation,
        layer_norm=layer_norm,
        encoder=encoder,
        initialisation=initialisation,
        device=device,
    )
    return TensorDictModule(network, in_keys=list(in_keys), out_keys=[out_key])
