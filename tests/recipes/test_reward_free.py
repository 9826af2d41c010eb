"""Methods that learn from takeovers never see the environment's reward or cost."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig
from tensordict import TensorDict

from haim_torchrl.data import TRANSITION_KEYS, make_replay_buffer
from haim_torchrl.envs.platoon_env import PlatoonEnv
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.terms import build_loss
from haim_torchrl.modules import make_actor, make_critic
from haim_torchrl.objectives import UpdateStep, make_optimizer
from haim_torchrl.transforms import REPLAY_KEYS

CONF = Path(__file__).parents[2] / "conf"
METHODS = sorted(path.stem for path in (CONF / "method").glob("*.yaml"))
REWARDED = {("next", name) for name in ("reward", "cost", "shaped_reward")}


def settings(method: str) -> DictConfig:
    register()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("haim", [f"method={method}"])


def transitions(reward: float, cost: float) -> TensorDict:
    """Some takeovers, with everything that a transition of the world holds."""
    draw = torch.Generator().manual_seed(0)

    def uniform(width: int) -> torch.Tensor:
        return torch.rand(16, width, generator=draw) * 2 - 1

    flags = torch.arange(16).unsqueeze(-1) % 2 == 0
    agent, mentor = uniform(2), uniform(2) * flags
    following = TensorDict(
        observation=uniform(5),
        reward=torch.full((16, 1), reward),
        cost=torch.full((16, 1), cost),
        takeover_cost=uniform(1).abs(),
        disturbance_cost=uniform(1).abs(),
        terminated=torch.zeros(16, 1).bool(),
        done=torch.zeros(16, 1).bool(),
        batch_size=[16],
    )
    return TensorDict(
        observation=uniform(5),
        action=torch.where(flags, mentor, agent),
        action_agent=agent,
        action_mentor=mentor,
        intervention=flags,
        takeover_start=flags,
        next=following,
        batch_size=[16],
    )


def learned(method: str, reward: float, cost: float) -> dict[str, torch.Tensor]:
    """Parameters after three updates of a method on its own replay."""
    torch.manual_seed(0)
    config = settings(method)
    actor = make_actor(5, 2, hidden=(8,))
    loss = build_loss(config.loss, actor, partial(make_critic, 5, 2, (8,)))
    assert not REWARDED & set(loss.in_keys)
    update = UpdateStep(loss, make_optimizer(loss), loss.make_target_updater(0.1))
    replay = make_replay_buffer(100, 8, keys=loss.in_keys)
    replay.extend(transitions(reward, cost))
    assert not REWARDED & set(replay.sample().keys(True, True))
    for _ in range(3):
        update(replay.sample())
    return {name: value.detach().clone() for name, value in loss.named_parameters()}


@pytest.mark.parametrize("method", METHODS)
def test_neither_reward_nor_cost_reaches_what_is_learned(method: str) -> None:
    nothing = learned(method, 0.0, 0.0)
    assert all(torch.isfinite(value).all() for value in nothing.values())
    unknown = learned(method, float("nan"), float("nan"))
    assert all(torch.equal(nothing[name], unknown[name]) for name in nothing)


def test_what_is_kept_by_default_holds_neither() -> None:
    assert not REWARDED & set(TRANSITION_KEYS)
    assert not REWARDED & set(REPLAY_KEYS)


def test_a_run_in_a_world_of_other_rewards_learns_the_same(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    arguments = (
        "preset=smoke", "total_frames=150", "env.horizon=60", "record=false", "logger=csv",
        "train.validate_every=0", "eval.checkpoint=last", "eval.pictures=false",
        "eval.test.count=1",
    )  # fmt: skip
    assert command("haim", *arguments, "name=before").code == 0
    told = PlatoonEnv._info
    monkeypatch.setattr(PlatoonEnv, "_reward", lambda self, action=None: -1e6)
    monkeypatch.setattr(PlatoonEnv, "_info", lambda self: {**told(self), "cost": 1e6})
    assert command("haim", *arguments, "name=after").code == 0
    one, other = (
        torch.load(next((tmp_path / "runs" / name).rglob("last.pt")), weights_only=True)
        for name in ("before", "after")
    )
    assert other["parts"]["log"]["totals"]["violations"] >= 1e6 * 150
    assert one["learner"].keys() == other["learner"].keys()
    for part in ("learner", "actor"):
        for name, value in one[part].items():
            assert torch.equal(value, other[part][name]), name
