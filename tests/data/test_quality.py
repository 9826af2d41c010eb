"""Figures of recorded driving, worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.data.quality import Quality


def episode(
    rewards: list[float],
    *,
    arrived: bool = False,
    costs: float = 0.0,
    done: bool = True,
    **next_: Any,
) -> TensorDict:
    """An episode that the mentor drove; its cost falls on the last step."""
    count = len(rewards)
    last = torch.arange(count).unsqueeze(-1) == count - 1
    after = {
        "reward": torch.tensor(rewards).unsqueeze(-1),
        "done": last & done,
        "success": last & arrived,
        "cost": last * costs,
        "disturbance_cost": torch.zeros(count, 1),
        **next_,
    }
    first = torch.arange(count).unsqueeze(-1) == 0
    entries = {"intervention": torch.ones(count, 1, dtype=torch.bool), "takeover_start": first}
    return TensorDict({**entries, "next": after}, batch_size=[count])


def test_figures_are_of_the_episodes_that_ended() -> None:
    braked = torch.tensor([[0.0], [0.5], [0.0]])
    quality = Quality.of(
        [
            episode([1.0, 2.0, 3.0], arrived=True, disturbance_cost=braked),
            episode([2.0], costs=1.0),
            episode([100.0, 100.0], done=False),
        ]
    )
    assert (quality.episodes, quality.finished, quality.steps) == (3, 2, 6)
    assert (quality.success, quality.cost, quality.disturbances) == (0.5, 0.5, 1)
    assert quality.mean_return == 4.0 and quality.sd_return == pytest.approx(math.sqrt(8.0))
    assert (quality.mentor_share, quality.takeovers) == (1.0, 3)


def test_what_nobody_says_is_unknown() -> None:
    bare = episode([1.0], done=False).exclude(
        ("next", "success"), ("next", "cost"), ("next", "disturbance_cost")
    )
    quality = Quality.of([bare])
    assert quality.success is quality.cost is quality.disturbances is None
    assert quality.as_dict()["mean_return"] is None and "success unknown" in str(quality)
    assert quality.complaint() is None


@pytest.mark.parametrize(
    ("arrivals", "cost", "words"),
    [
        (10, 0.0, []),
        (9, 0.0, []),
        (8, 0.0, ["only 0.80 of the episodes arrive"]),
        (10, 2.0, ["an episode costs 0.20"]),
        (8, 2.0, ["only 0.80 of the episodes arrive", "an episode costs 0.20"]),
    ],
)
def test_bad_driving_is_complained_of_in_one_sentence(
    arrivals: int, cost: float, words: list[str]
) -> None:
    episodes = [episode([1.0], arrived=k < arrivals, costs=cost * (k == 0)) for k in range(10)]
    complaint = Quality.of(episodes).complaint()
    assert (complaint is None) == (not words)
    assert all(word in (complaint or "") for word in words)
