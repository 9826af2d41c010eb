"""Tiny networks whose values can be worked out by hand, and batches for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.distributions import Distribution
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import Temperature, make_actor, make_critic
from haim_torchrl.objectives import (
    ActorLoss,
    ConservativePreferenceLoss,
    ExplicitInterventionLoss,
    HAIMLoss,
    ImplicitInterventionLoss,
    LinearPreferenceLoss,
    LossTerm,
    ProxyQLoss,
    TargetUpdater,
    TemperatureLoss,
)


class KnownDensity(Distribution):
    """Draws always ``loc`` and reports ``density`` as its log-density."""

    arg_constraints: dict = {}
    has_rsample = True

    def __init__(self, loc: Tensor, density: Tensor) -> None:
        self.loc, self.density = loc, density
        super().__init__(loc.shape[:-1], loc.shape[-1:], validate_args=False)

    def rsample(self, sample_shape: tuple[int, ...] = ()) -> Tensor:
        return self.loc

    def log_prob(self, value: Tensor) -> Tensor:
        return self.density.squeeze(-1)


class KnownPolicy(nn.Module):
    """a = gain * s with log-density gain - 1.2 (so that its gradient shows)."""

    def __init__(self, gain: float = 0.5) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.tensor([gain]))

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        return self.gain * observation, (self.gain - 1.2).expand_as(observation)


class LinearCritic(nn.Module):
    """Q_e = w_e . (s, a), one row of weights for each member."""

    def __init__(self, *rows: tuple[float, float]) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.tensor(rows))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return torch.cat([observation, action], -1) @ self.weight.T


def known_actor(gain: float = 0.5, key: str = "observation") -> ProbabilisticActor:
    network = TensorDictModule(KnownPolicy(gain), in_keys=[key], out_keys=["loc", "density"])
    return ProbabilisticActor(
        network,
        in_keys=["loc", "density"],
        out_keys=["action"],
        distribution_class=KnownDensity,
    )


def linear_critic(
    *rows: tuple[float, float], action: str = "action", value: str = "state_action_value"
) -> TensorDictModule:
    return TensorDictModule(LinearCritic(*rows), in_keys=["observation", action], out_keys=[value])


def column(*numbers: float) -> Tensor:
    return torch.tensor(numbers).unsqueeze(-1)


@pytest.fixture
def actor() -> ProbabilisticActor:
    return known_actor()


@pytest.fixture
def make_linear_critic() -> Callable[..., TensorDictModule]:
    return linear_critic


@pytest.fixture
def make_known_actor() -> Callable[..., ProbabilisticActor]:
    return known_actor


@pytest.fixture
def batch() -> TensorDict:
    """Three transitions: taken over and going on, free and terminated, free and truncated."""
    return TensorDict(
        {
            "observation": column(2.0, 1.0, 0.0),
            "action": column(1.0, -1.0, 0.5),
            "action_agent": column(-1.0, -1.0, 0.5),
            "action_mentor": column(1.0, 0.0, 0.0),
            "intervention": column(1, 0, 0).bool(),
            "next": {
                "observation": column(4.0, 2.0, 6.0),
                "terminated": column(0, 1, 0).bool(),
                "truncated": column(0, 0, 1).bool(),
                "done": column(0, 1, 1).bool(),
                "takeover_cost": column(2.0, 0.0, 0.0),
                "disturbance_cost": column(0.0, 0.5, 0.25),
            },
        },
        batch_size=[3],
    )


@dataclass
class Method:
    """All of HAIM-DRL on small real networks, with a batch to fit."""

    actor: ProbabilisticActor
    critics: dict[str, TensorDictModule]
    temperature: Temperature
    loss: HAIMLoss
    batch: TensorDict
    updater: TargetUpdater = field(init=False)

    def __post_init__(self) -> None:
        self.updater = self.loss.make_target_updater(0.005)

    def parameters(self) -> dict[str, list[nn.Parameter]]:
        """All parameters there are, by the network that owns them."""
        owners = {"actor": self.actor, **self.critics, "temperature": self.temperature}
        return {name: list(network.parameters()) for name, network in owners.items()}


def random_batch(size: int = 8, observation_dim: int = 5, action_dim: int = 2) -> TensorDict:
    intervention = torch.arange(size).unsqueeze(-1) % 2 == 0
    agent = torch.rand(size, action_dim) * 2 - 1
    mentor = (torch.rand(size, action_dim) * 2 - 1) * intervention
    return TensorDict(
        {
            "observation": torch.randn(size, observation_dim),
            "action": torch.where(intervention, mentor, agent),
            "action_agent": agent,
            "action_mentor": mentor,
            "intervention": intervention,
            "next": {
                "observation": torch.randn(size, observation_dim),
                "terminated": torch.rand(size, 1) < 0.2,
                "takeover_cost": torch.rand(size, 1),
                "disturbance_cost": torch.rand(size, 1),
            },
        },
        batch_size=[size],
    )


def make_method(conservative: bool = False, **options: str) -> Method:
    torch.manual_seed(0)
    actor = make_actor(5, 2, hidden=(16, 16))
    critics = {n: make_critic(5, 2, hidden=(16, 16)) for n in ("proxy", "explicit", "implicit")}
    temperature = Temperature()
    preference: LossTerm = LinearPreferenceLoss(critics["proxy"], **options)
    if conservative:
        preference = ConservativePreferenceLoss(actor, critics["proxy"], **options)
    loss = HAIMLoss(
        {
            "proxy": ProxyQLoss(actor, critics["proxy"], temperature, **options),
            "preference": preference,
            "explicit": ExplicitInterventionLoss(actor, critics["explicit"], **options),
            "implicit": ImplicitInterventionLoss(actor, critics["implicit"], **options),
            "temperature": TemperatureLoss(actor, temperature, **options),
            "actor": ActorLoss(
                actor,
                {
                    "proxy": (critics["proxy"], 1.0, "min"),
                    "explicit": (critics["explicit"], -1.0, "max"),
                    "implicit": (critics["implicit"], -1.0, "max"),
                },
                temperature,
                **options,
            ),
        }
    )
    return Method(actor, critics, temperature, loss, random_batch())


@pytest.fixture
def method() -> Method:
    return make_method()


@pytest.fixture
def method_factory() -> Callable[..., Method]:
    return make_method
