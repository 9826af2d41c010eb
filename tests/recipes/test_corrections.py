"""A problem made to need corrections: HG-DAgger and IWR solve it, and cloning alone does not."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase, GymWrapper, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import BCLoss

from haim_torchrl.collectors import make_collector
from haim_torchrl.data import Aggregate, make_replay_buffer
from haim_torchrl.data.demonstrations import record_demonstrations
from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.modules import make_actor, make_ensemble_actor
from haim_torchrl.objectives import EnsembleCloningLoss, UpdateStep
from haim_torchrl.transforms import InterventionTransform

pytestmark = pytest.mark.filterwarnings("ignore:The name target_actor_network_params")

HORIZON = 40
PUSH = 0.3


class Ledge(gymnasium.Env):
    """A ridge of half width 1 that one slides off: x' = 1.1 x + 0.3 a.

    Who is set down in its middle stays there without a steering movement. In a wind one is set
    down beside the middle instead, and must steer against the slope.

    Args:
        windy: whether there is a wind.
        poison: what rewards and costs are.
    """

    def __init__(self, windy: bool, poison: float = 0.0) -> None:
        self.observation_space = gymnasium.spaces.Dict(
            {
                "observation": gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float32),
                "cost": gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float32),
            }
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.windy, self.poison, self.x, self.steps = windy, poison, 0.0, 0
        self.side = 1.0

    def _seen(self) -> dict[str, np.ndarray]:
        return {
            "observation": np.array([self.x], np.float32),
            "cost": np.array([self.poison], np.float32),
        }

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict]:
        super().reset(seed=seed)
        self.side = -self.side
        self.x, self.steps = self.side * PUSH * self.windy, 0
        return self._seen(), {}

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict]:
        self.x, self.steps = slide(self.x, float(action[0])), self.steps + 1
        return self._seen(), self.poison, abs(self.x) > 1.0, self.steps >= HORIZON, {}


def slide(x: float, action: float) -> float:
    return 1.1 * x + 0.3 * min(1.0, max(-1.0, action))


def mentor() -> FunctionMentor:
    """Steers to the middle."""
    return FunctionMentor(lambda simulator, step: [min(1.0, max(-1.0, -2.0 * simulator.x))])


class NearTheEdge:
    """Takes over beyond 0.6 and hands back within 0.1."""

    memoryless = True

    def reset(self) -> None:
        """Nothing to forget."""

    def __call__(self, situation: Any) -> bool:
        return abs(situation.simulator.x) > (0.1 if situation.was_intervening else 0.6)


def in_the_wind(poison: float = 0.0) -> EnvBase:
    return TransformedEnv(
        GymWrapper(Ledge(True, poison)), InterventionTransform(mentor, NearTheEdge())
    )


def learn(method: str, rounds: int, poison: float = 0.0) -> TensorDictModuleBase:
    """The loop of the recipe, in small: demonstrations in calm air, rounds in the wind."""
    torch.manual_seed(0)
    policy, loss = make_policy(method)
    update = UpdateStep(loss, torch.optim.Adam(loss.parameters(), lr=3e-3))
    sampling = "uniform" if method == "hg_dagger" else "balanced"
    replay = make_replay_buffer(1000, 64, sampling=sampling, keys=loss.in_keys)  # type: ignore[arg-type]
    data = Aggregate(replay, "mentor" if method == "hg_dagger" else "all")
    shown = record_demonstrations(lambda: GymWrapper(Ledge(False)), mentor(), 80, [0])
    assert shown["observation"].abs().max() == 0.0
    data.add_demonstrations(shown)
    collector = make_collector(
        lambda: in_the_wind(poison),
        policy,
        frames_per_batch=80,
        seed=0,
        exploration_type=ExplorationType.DETERMINISTIC,
    )
    driven = iter(collector)
    for number in range(rounds + 1):
        if number:
            data.add_round(next(driven))
        for _ in range(120):
            update(replay.sample())
        collector.update_policy_weights_()
    collector.shutdown()
    return policy


def make_policy(method: str) -> tuple[TensorDictModuleBase, Any]:
    if method == "hg_dagger":
        ensemble = make_ensemble_actor(1, 1, hidden=(32, 32), members=3)
        return ensemble, EnsembleCloningLoss(ensemble)
    actor = make_actor(1, 1, hidden=(32, 32))
    return actor, BCLoss(actor, loss_function="l2")


def stays(policy: TensorDictModuleBase) -> float:
    """Share of starts beside the middle from which the policy alone does not slide off."""
    starts = torch.tensor([-0.5, -0.4, -0.3, -0.2, 0.2, 0.3, 0.4, 0.5])
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        x, inside = starts.clone(), torch.ones_like(starts, dtype=torch.bool)
        for _ in range(HORIZON):
            seen = TensorDict({"observation": x.unsqueeze(-1)}, batch_size=[len(x)])
            action: Tensor = policy(seen)["action"].squeeze(-1)
            x = 1.1 * x + 0.3 * action.clamp(-1.0, 1.0)
            inside &= x.abs() <= 1.0
    return inside.float().mean().item()


@pytest.mark.parametrize("method", ["hg_dagger", "iwr"])
def test_corrections_teach_what_demonstrations_do_not_show(method: str) -> None:
    cloned, corrected = stays(learn(method, rounds=0)), stays(learn(method, rounds=3))
    assert cloned <= 0.25
    assert corrected == 1.0


@pytest.mark.parametrize("method", ["hg_dagger", "iwr"])
def test_rewards_and_costs_are_never_read(method: str) -> None:
    expected, poisoned = learn(method, rounds=1), learn(method, rounds=1, poison=float("nan"))
    for first, second in zip(expected.parameters(), poisoned.parameters()):
        assert torch.equal(first, second)
