"""The world as a TorchRL environment."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs import SerialEnv
from torchrl.envs.utils import check_env_specs

from haim_torchrl.envs import PlatoonEnv, make_env

FLOATS = ("speed", "acceleration", "progress", "cost")
FLAGS = ("success", "crash", "out_of_road", "wrong_way")


@pytest.mark.parametrize("config", [{}, {"followers": 2, "observation": {"view": "rays"}}])
def test_torchrls_checker_is_content(config):
    check_env_specs(make_env(**config), seed=0)


def test_a_batch_of_worlds():
    check_env_specs(SerialEnv(2, make_env), seed=0)


def test_entries_are_those_of_the_keys_table():
    env = make_env(followers=3)
    root = env.reset()
    step = env.step(root.set("action", torch.tensor([0.5, 0.0])))
    for place in (root, step["next"]):
        for key in FLOATS:
            assert place[key].shape == (1,)
            assert place[key].dtype == torch.float32
        for key in FLAGS:
            assert place[key].shape == (1,)
            assert place[key].dtype == torch.bool
        for key in ("follower_gaps", "follower_speeds"):
            assert place[key].shape == (3,)
            assert place[key].dtype == torch.float32
    assert step["next", "acceleration"].item() == pytest.approx(2.0)
    assert step["next", "reward"].item() > 0.0


def test_it_steps_as_the_simulator_does():
    """TorchRL's generic step, which this environment shortens, shows the same."""
    env = make_env()
    blank = env.reset(seed=5)
    bare = PlatoonEnv()
    bare.reset(seed=5)
    generator = torch.Generator().manual_seed(0)
    for _ in range(40):
        action = torch.rand(2, generator=generator) * torch.tensor([1.0, 0.02])
        shown = env.step(blank.clone().set("action", action))
        observation, reward, terminated, truncated, info = bare.step(action.numpy())
        after = shown["next"]
        assert torch.equal(after["observation"], torch.from_numpy(observation))
        assert after["reward"].item() == pytest.approx(reward)
        assert after["terminated"].item() == terminated
        assert after["truncated"].item() == truncated
        assert after["done"].item() == (terminated or truncated)
        for key in (*FLOATS, *FLAGS):
            assert after[key].item() == pytest.approx(info[key])
        if terminated:
            break


def test_a_seed_gives_one_rollout():
    rollouts = []
    for _ in range(2):
        env = make_env(scenarios=3)
        env.set_seed(11)
        torch.manual_seed(0)
        rollouts.append(env.rollout(60, break_when_any_done=False))
    assert (rollouts[0] == rollouts[1]).all()


def test_resets_keep_to_the_set():
    env = make_env(first_scenario=40, scenarios=2, scenario={"block_count": 1})
    env.set_seed(0)
    drawn = set()
    for _ in range(12):
        env.reset()
        drawn.add(env.unwrapped.scenario.seed)
    assert drawn == {40, 41}
