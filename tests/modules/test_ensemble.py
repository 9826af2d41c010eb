"""An ensemble of actors: its mean, its doubt worked out by hand, what can be made of it."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from haim_torchrl.modules import (
    EnsembleActor,
    doubt_threshold,
    ensemble_doubt,
    make_ensemble_actor,
)


def acted(policy: Any, observation: torch.Tensor) -> TensorDict:
    return policy(TensorDict({"observation": observation}, batch_size=observation.shape[:-1]))


def test_doubt_by_hand() -> None:
    # Variances of two members: (.2 - -.2)²/2 = .08 and (1 - 0)²/2 = .5.
    two = torch.tensor([[0.2, 1.0], [-0.2, 0.0]])
    assert ensemble_doubt(two).item() == pytest.approx(math.hypot(0.08, 0.5))
    # Of three: 0, 1, 2 has the variance 1; nobody disagrees on the second action.
    three = torch.tensor([[0.0, 0.5], [1.0, 0.5], [2.0, 0.5]])
    assert ensemble_doubt(three).tolist() == [1.0]
    assert ensemble_doubt(torch.stack([two, torch.zeros(2, 2)])).shape == (2, 1)


@pytest.mark.parametrize("shape", [(2,), (1, 2), (7, 1, 2)])
def test_who_is_alone_has_no_doubt_and_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="at least two members E"):
        ensemble_doubt(torch.zeros(shape))


@given(
    st.lists(st.lists(st.floats(-1, 1), min_size=2, max_size=2), min_size=2, max_size=6),
    st.floats(-1, 1),
)
def test_doubt_is_of_the_differences_alone(actions: list[list[float]], shift: float) -> None:
    members = torch.tensor(actions, dtype=torch.float64)
    doubt = ensemble_doubt(members)
    assert doubt.item() >= 0.0
    torch.testing.assert_close(ensemble_doubt(members + shift), doubt)
    torch.testing.assert_close(ensemble_doubt(members.flip(0)), doubt)
    torch.testing.assert_close(ensemble_doubt(3.0 * members), 9.0 * doubt)
    assert ensemble_doubt(members[:1].expand(4, 2)).item() == pytest.approx(0.0, abs=1e-12)


def test_the_threshold_is_the_mean_of_the_last_quarter() -> None:
    doubts = torch.tensor([8.0, 8.0, 8.0, 8.0, 8.0, 8.0, 2.0, 4.0])
    assert doubt_threshold(doubts) == 3.0
    assert doubt_threshold(doubts, share=0.125) == 4.0
    assert doubt_threshold(doubts, share=1.0) == 6.75
    assert doubt_threshold(torch.tensor([5.0, 7.0])) == 7.0
    assert math.isnan(doubt_threshold(torch.empty(0)))
    with pytest.raises(ValueError, match="share must lie in"):
        doubt_threshold(doubts, share=0.0)


def test_the_mean_drives_and_the_doubt_stands_beside_it() -> None:
    torch.manual_seed(0)
    policy = make_ensemble_actor(4, 2, hidden=(8,), members=3)
    data = acted(policy, torch.randn(6, 4))
    assert data["action_members"].shape == (6, 3, 2)
    torch.testing.assert_close(data["action"], data["action_members"].mean(1))
    torch.testing.assert_close(data["doubt"], ensemble_doubt(data["action_members"]))
    assert (data["doubt"] > 0.0).all() and (data["action"].abs() < 1.0).all()
    assert acted(policy, torch.randn(4))["doubt"].shape == (1,)


def test_it_does_the_same_whatever_the_exploration_type() -> None:
    policy, seen = make_ensemble_actor(4, 2, hidden=(8,)), torch.randn(6, 4)
    with set_exploration_type(ExplorationType.RANDOM):
        first = acted(policy, seen)["action"]
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(acted(policy, seen)["action"], first)


def test_equal_members_have_no_doubt() -> None:
    policy = make_ensemble_actor(4, 2, hidden=(8,), members=2)
    first, second = policy.module.members
    second.load_state_dict(first.state_dict())
    assert torch.equal(acted(policy, torch.randn(5, 4))["doubt"], torch.zeros(5, 1))


def test_each_member_sees_an_image_with_an_encoder_of_its_own() -> None:
    shapes = {"pixels": (5, 42, 42), "state": (1,)}
    policy = make_ensemble_actor(shapes, 2, hidden=(8,), members=2, channels=(2, 2, 2))
    assert list(policy.in_keys) == ["pixels", "state"]
    first, second = policy.module.members
    assert first.encoder is not second.encoder
    seen = {"pixels": torch.zeros(3, 5, 42, 42, dtype=torch.uint8), "state": torch.zeros(3, 1)}
    assert policy(TensorDict(seen, batch_size=[3]))["action"].shape == (3, 2)


def test_too_few_members_are_refused() -> None:
    for members in (0, 1):
        with pytest.raises(
            ValueError, match=f"members must be at least 2, to disagree, got {members}"
        ):
            make_ensemble_actor(4, 2, members=members)
    with pytest.raises(ValueError, match="at least 2"):
        EnsembleActor([])
