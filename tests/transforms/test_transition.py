import pytest
import torch
from tensordict import TensorDict

from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import ActionSwitch, Always
from haim_torchrl.transforms import (
    REPLAY_KEYS,
    TRANSITION_TABLE,
    DisturbanceTransform,
    InterventionTransform,
    TakeoverToTransition,
)


@pytest.fixture
def rollout(car):
    """Ten steps of a car whose mentor brakes when the agent accelerates."""

    def mentor():
        return FunctionMentor(lambda simulator, step: [-0.5, 0.0])

    env = car(InterventionTransform(mentor, ActionSwitch(0.7)), DisturbanceTransform())
    env.set_seed(0)
    torch.manual_seed(0)
    return env.rollout(20)


def test_has_the_documented_table(rollout):
    transition = TakeoverToTransition()(rollout)
    sizes = {"1": 1, "A": 2, "D": 1}
    for row in TRANSITION_TABLE:
        entry = transition[row.name] if row.place == "root" else transition["next", row.name]
        assert entry.shape == (20, sizes[row.size]), row
        assert row.dtype is None or entry.dtype == row.dtype, row


def test_input_stays_as_it_was(rollout):
    before = rollout.clone()
    TakeoverToTransition(keep=REPLAY_KEYS)(rollout)
    assert (rollout == before).all()
    assert set(rollout.keys(True)) == set(before.keys(True))


def test_any_batch_shape(rollout):
    transition = TakeoverToTransition()(torch.stack([rollout, rollout]))
    assert transition.batch_size == (2, 20)
    assert torch.equal(transition["action"][1], rollout["next", "behavior_action"])


def test_keeps_what_it_is_told_to(rollout):
    transition = TakeoverToTransition(keep=REPLAY_KEYS)(rollout)
    assert set(transition.keys(True, True)) == set(REPLAY_KEYS)
    assert ("next", "disturbance_cost") in REPLAY_KEYS
    assert ("next", "reward") not in REPLAY_KEYS


def test_other_peoples_data_are_refused():
    steps = TensorDict(
        action=torch.zeros(3, 2), next=TensorDict(reward=torch.zeros(3, 1)), batch_size=[3]
    )
    with pytest.raises(KeyError, match="do not say who drove"):
        TakeoverToTransition()(steps)


def test_without_disturbance_or_reward_it_works_too(pendulum):
    transition = TakeoverToTransition(keep=REPLAY_KEYS)(pendulum(Always()).rollout(3))
    assert transition["intervention"].all()
    assert ("next", "disturbance_cost") not in transition.keys(True)
