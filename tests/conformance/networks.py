"""The small networks and the one batch on which all cases of the suite are built."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import TypeVar, cast

import torch
from tensordict import NestedKey, TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor

from haim_torchrl.modules import (
    EnsembleMLP,
    Temperature,
    make_actor,
    make_critic,
    make_ensemble_actor,
)

OBSERVATION, ACTION, MEMBERS, HIDDEN = 5, 2, 2, (16, 16)
#: Makes another name of an entry.
Rename = Callable[[str], NestedKey]
Network = TypeVar("Network", bound=nn.Module)


def same(name: str) -> NestedKey:
    """Leaves a name as it is."""
    return name


class OneByOne(nn.Module):
    """The members of a vectorised ensemble as networks of their own, called in a loop.

    Args:
        ensemble: whose members are copied.
    """

    def __init__(self, ensemble: EnsembleMLP) -> None:
        super().__init__()
        self.members = nn.ModuleList(
            EnsembleMLP(OBSERVATION, ACTION, HIDDEN, ensemble_size=1) for _ in range(MEMBERS)
        )
        for index, member in enumerate(self.members):
            state = ensemble.state_dict().items()
            member.load_state_dict({name: part.chunk(MEMBERS)[index] for name, part in state})

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Values ``[..., E]``."""
        return torch.cat([member(observation, action) for member in self.members], -1)


class SingleCritic(nn.Module):
    """One critic Q(s, a), as TorchRL's own losses take it: they make the ensemble themselves."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(OBSERVATION + ACTION, 16), nn.ReLU(), nn.Linear(16, 1)
        )

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Values ``[..., 1]``."""
        return self.layers(torch.cat([observation, action], -1))


class Networks:
    """What a loss is made of: each network is made at its first use, and then shared.

    A network depends on the seed and on its name, not on the order in which networks are made.

    Args:
        rename: makes the networks read and write entries of other names.
        reduction: handed to the loss.
        alpha: entropy temperature at the start.
        one_by_one: evaluate the members of an ensemble in a loop instead of all at once.
        seed: draws the parameters.
    """

    def __init__(
        self,
        *,
        rename: Rename = same,
        reduction: str | None = None,
        alpha: float = 0.2,
        one_by_one: bool = False,
        seed: int = 0,
    ) -> None:
        self.rename = rename
        self.reduction = reduction
        self.alpha = alpha
        self.one_by_one = one_by_one
        self.seed = seed
        self.made: dict[str, nn.Module] = {}

    @property
    def actor(self) -> ProbabilisticActor:
        """The agent's stochastic policy."""
        keys = {"in_keys": [self.rename("observation")], "action_key": self.rename("action")}
        return self._once("actor", lambda: make_actor(OBSERVATION, ACTION, HIDDEN, **keys))

    @property
    def deterministic_actor(self) -> TensorDictModule:
        """A policy without a distribution, with actions in [-1, 1]."""

        def make() -> TensorDictModule:
            network = nn.Sequential(nn.Linear(OBSERVATION, ACTION), nn.Tanh())
            return TensorDictModule(
                network, in_keys=[self.rename("observation")], out_keys=[self.rename("action")]
            )

        return self._once("deterministic_actor", make)

    @property
    def ensemble_actor(self) -> TensorDictModule:
        """Several deterministic policies as one."""

        def make() -> TensorDictModule:
            out_keys = [self.rename(key) for key in ("action_members", "action", "doubt")]
            in_keys = [self.rename("observation")]
            return make_ensemble_actor(
                OBSERVATION, ACTION, HIDDEN, members=MEMBERS, in_keys=in_keys, out_keys=out_keys
            )

        return self._once("ensemble_actor", make)

    @property
    def temperature(self) -> Temperature:
        """The learnable entropy temperature."""
        return self._once("temperature", lambda: Temperature(self.alpha))

    def critic(self, name: str) -> TensorDictModule:
        """Twin critics, evaluated together or one by one."""

        def make() -> TensorDictModule:
            keys = [self.rename("observation"), self.rename("action")]
            value = self.rename("state_action_value")
            critic = make_critic(OBSERVATION, ACTION, HIDDEN, in_keys=keys, out_key=value)
            if not self.one_by_one:
                return critic
            return TensorDictModule(OneByOne(critic.module), in_keys=keys, out_keys=[value])

        return self._once(name, make)

    @property
    def single_critic(self) -> TensorDictModule:
        """One critic, for losses that make the ensemble themselves."""

        def make() -> TensorDictModule:
            keys = [self.rename("observation"), self.rename("action")]
            value = self.rename("state_action_value")
            return TensorDictModule(SingleCritic(), in_keys=keys, out_keys=[value])

        return self._once("single_critic", make)

    def _once(self, name: str, make: Callable[[], Network]) -> Network:
        if name not in self.made:
            with torch.random.fork_rng():
                torch.manual_seed(zlib.crc32(f"{self.seed} {name}".encode()))
                self.made[name] = make()
        return cast(Network, self.made[name])


def make_batch(size: int = 8) -> TensorDict:
    """Transitions with all entries that any loss reads; some taken over, some terminated.

    Args:
        size: how many, at least 4.
    """
    draw = torch.Generator().manual_seed(0)

    def uniform(width: int) -> Tensor:
        return torch.rand(size, width, generator=draw) * 2 - 1

    step = torch.arange(size).unsqueeze(-1)
    intervention = step % 4 < 2
    agent, mentor = uniform(ACTION), uniform(ACTION) * intervention
    return TensorDict(
        {
            "observation": uniform(OBSERVATION),
            "action": torch.where(intervention, mentor, agent),
            "action_agent": agent,
            "action_mentor": mentor,
            "intervention": intervention,
            "takeover_start": step % 4 == 0,
            "next": {
                "observation": uniform(OBSERVATION),
                "reward": uniform(1),
                "cost": uniform(1).abs(),
                "takeover_cost": uniform(1).abs(),
                "disturbance_cost": uniform(1).abs(),
                "terminated": step % 4 == 3,
                "truncated": step % 4 == 1,
                "done": step % 2 == 1,
            },
        },
        batch_size=[size],
    )


def renamed_entries(batch: TensorDict, rename: Rename) -> TensorDict:
    """The same data under other names, at the root and under ``next``."""
    result = TensorDict(batch_size=batch.batch_size)
    for key, value in batch.items(True, True):
        new = rename(key) if isinstance(key, str) else ("next", rename(key[-1]))
        result.set(new, value)
    return result
