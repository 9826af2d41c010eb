"""The example elsewhere: its mentor solves the task, and its policy learns that from takeovers."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from haim_torchrl.switches import Always, Never

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "pendulum.py"


@pytest.fixture(scope="module")
def example() -> dict[str, Any]:
    return runpy.run_path(str(EXAMPLE))


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def test_the_mentor_swings_up_and_stays_there(example: dict[str, Any]) -> None:
    env = example["make_env"](Always())
    env.set_seed(0)
    for _ in range(5):
        cosine = env.rollout(200)["next", "observation"][..., 0]
        assert (cosine[-50:] > 0.99).all()


def test_the_policy_learns_from_takeovers(example: dict[str, Any]) -> None:
    returns, replay = example["main"](["--frames", "2500", "--seed", "1"])
    assert returns["mentor"] > -250.0
    assert returns["policy alone"] > 0.5 * returns["random actions"]

    assert len(replay) == 2500
    assert len(replay.free) > 500 and len(replay.intervened) > 500
    sample = replay.sample(2000)
    taken = sample["intervention"].squeeze(-1)
    executed, proposed = sample["action"], sample["action_agent"]
    assert torch.equal(executed[~taken], proposed[~taken])
    assert ((executed - proposed)[taken].abs() > 0.5).all()
    assert sample["next", "takeover_cost"][taken].any()
    assert not sample["next", "takeover_cost"][~taken].any()


def test_evaluation_repeats_its_episodes(example: dict[str, Any]) -> None:
    evaluate = example["evaluate"]
    assert evaluate(Always(), episodes=2) == evaluate(Always(), episodes=2)
    torch.manual_seed(0)
    assert evaluate(Never(), episodes=2) < evaluate(Always(), episodes=2) - 100.0
