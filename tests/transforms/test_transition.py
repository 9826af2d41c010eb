import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

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


def test_action_and_flags_come_to_the_root(rollout):
    transition = TakeoverToTransition()(rollout)
    flag = transition["intervention"]
    assert flag.any() and not flag.all()
    assert torch.equal(
        transition["action"],
        torch.where(flag, transition["action_mentor"], transition["action_agent"]),
    )
    assert torch.equal(transition["action_agent"], rollout["action"])
    assert torch.equal(flag, rollout["next", "intervention"])
    assert torch.equal(transition["takeover_start"], rollout["next", "takeover_start"])
    for cost in ("takeover_cost", "disturbance_cost", "disturbance"):
        assert torch.equal(transition["next", cost], rollout["next", cost])


def test_nothing_of_the_last_step_remains(rollout):
    transition = TakeoverToTransition()(rollout)
    for key in ("takeover_cost", "disturbance", "disturbance_onset", "disturbance_cost"):
        assert key not in transition
    assert "behavior_action" not in transition
    left = {"action_agent", "action_mentor", "behavior_action", "intervention", "takeover_start"}
    assert not left & set(transition["next"].keys())
    assert {"observation", "speed"} <= set(transition.keys())
    assert {"observation", "reward", "done"} <= set(transition["next"].keys())


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


def test_twice_is_once(rollout):
    once = TakeoverToTransition()(rollout)
    twice = TakeoverToTransition()(once)
    assert set(once.keys(True, True)) == set(twice.keys(True, True))
    assert (once == twice).all()


def test_any_batch_shape(rollout):
    transition = TakeoverToTransition()(torch.stack([rollout, rollout]))
    assert transition.batch_size == (2, 20)
    assert torch.equal(transition["action"][1], rollout["next", "behavior_action"])


def test_keeps_what_it_is_told_to(rollout):
    transition = TakeoverToTransition(keep=REPLAY_KEYS)(rollout)
    assert set(transition.keys(True, True)) == set(REPLAY_KEYS)
    assert ("next", "disturbance_cost") in REPLAY_KEYS
    assert ("next", "reward") not in REPLAY_KEYS


def test_stored_and_sampled_by_a_replay_buffer(rollout):
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100), batch_size=20, transform=TakeoverToTransition(REPLAY_KEYS)
    )
    buffer.extend(rollout)
    stored = buffer[:]
    assert torch.equal(stored["action"], rollout["next", "behavior_action"])
    sample = buffer.sample()
    flag = sample["intervention"]
    assert torch.equal(
        sample["action"], torch.where(flag, sample["action_mentor"], sample["action_agent"])
    )
    assert "speed" not in sample


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
