"""The reward less the weighed cost."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.transforms import ShapedReward


def steps() -> TensorDict:
    following = TensorDict(
        reward=torch.tensor([[1.0], [2.0]]), cost=torch.tensor([[0.0], [1.0]]), batch_size=[2]
    )
    return TensorDict(next=following, batch_size=[2])


def test_by_hand_beside_the_reward_itself() -> None:
    given = steps()
    found = ShapedReward(5.0)(given)["next"]
    assert found["shaped_reward"].flatten().tolist() == [1.0, -3.0]
    assert found["reward"].flatten().tolist() == [1.0, 2.0]
    assert set(given["next"].keys()) == {"reward", "cost"}


def test_other_names() -> None:
    renamed = TensorDict(
        next=TensorDict(pay=torch.ones(2, 1), toll=torch.ones(2, 1).bool(), batch_size=[2]),
        batch_size=[2],
    )
    found = ShapedReward(0.25, reward="pay", cost="toll", out="rest")(renamed)
    assert found["next", "rest"].flatten().tolist() == [0.75, 0.75]


@pytest.mark.parametrize("missing", ["reward", "cost"])
def test_a_world_without_cost_is_named(missing: str) -> None:
    with pytest.raises(KeyError, match=f"no entry '{missing}'"):
        ShapedReward(1.0)(steps().exclude(("next", missing)))


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_a_weight_must_be_a_number_that_is_not_negative(weight: float) -> None:
    with pytest.raises(ValueError, match="cost_weight must be a number of at least 0"):
        ShapedReward(weight)
