"""A session that is driven again is the session, or says where it is not."""

import dataclasses
import functools

import pytest
import torch
from torchrl.envs import Compose, GymEnv, StepCounter, TransformedEnv

from haim_torchrl.data import SessionError, read_session
from haim_torchrl.envs import make_env
from haim_torchrl.mentors import (
    DeviceMentor,
    FunctionMentor,
    ProposingMentor,
    ReplayMentor,
    RequestingMentor,
    StatefulMentor,
)
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import ActionSwitch, Always, Hold, Never, RequestSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform, SessionRecorder

OFTEN = Hold(ActionSwitch(1.2), 3)


def world(mentor, switch, path, **settings):
    chain = Compose(
        InterventionTransform(mentor, switch), DisturbanceTransform(), SessionRecorder(path)
    )
    settings = {"horizon": 8, "scenarios": 20, **settings}
    return TransformedEnv(make_env(**settings), chain)


def drive(env, steps, seed):
    """Random actions through as many episodes as it takes."""
    env.set_seed(seed)
    torch.manual_seed(seed)
    try:
        return env.rollout(steps, break_when_any_done=False)
    finally:
        env.close()


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """Twenty steps in three episodes of at most eight, and what the collector would have got."""
    path = tmp_path_factory.mktemp("session") / "session.jsonl"
    rollout = drive(world(ExpertMentor, OFTEN, path), 20, seed=0)
    assert 0 < rollout["next", "intervention"].sum() < 20
    return path, rollout


def again(path, target, switch=RequestSwitch, exact=True, **settings):
    mentor = functools.partial(ReplayMentor, path, exact=exact)
    return world(mentor, switch(), target, **settings)


def timeless(path):
    return [dataclasses.replace(step, time=0.0) for step in read_session(path).steps()]


def test_another_agent_with_another_seed_drives_the_same(session, tmp_path):
    path, rollout = session
    replayed = drive(again(path, tmp_path / "again.jsonl"), 20, seed=1)
    assert not torch.equal(replayed["action"], rollout["action"])
    assert (replayed["next"] == rollout["next"]).all()
    assert torch.equal(replayed["observation"], rollout["observation"])
    assert timeless(tmp_path / "again.jsonl") == timeless(path)


def test_a_replay_can_be_replayed(session, tmp_path):
    path, rollout = session
    first, second = tmp_path / "first.jsonl", tmp_path / "second.jsonl"
    drive(again(path, first), 20, seed=1)
    assert (drive(again(first, second), 20, seed=2)["next"] == rollout["next"]).all()


def test_it_stops_before_the_record_ends(session, tmp_path):
    path, rollout = session
    replayed = drive(again(path, tmp_path / "again.jsonl"), 11, seed=1)
    assert (replayed["next"] == rollout["next"][:11]).all()


def test_the_end_of_the_record_is_one_sentence(session, tmp_path):
    with pytest.raises(SessionError, match=r"ends after 20 steps.*total_frames of at most that"):
        drive(again(session[0], tmp_path / "again.jsonl"), 21, seed=1)
    assert len(read_session(tmp_path / "again.jsonl")) == 20


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"horizon": 9}, "episode 0, step 8: the episode goes on, and in the record it had ended"),
        ({"horizon": 5}, "episode 0, step 5: the episode ends here, and the record goes on"),
        ({"first_scenario": 100}, r"episode 0, step 0: the simulator is in scenario 1\d\d, and"),
        ({"observation": {"rays": 60}}, "episode 0, step 0: the agent sees"),
        ({"initial_speed": 3.0}, "episode 0, step 0: the agent sees something else than it did"),
    ],
)
def test_a_departure_is_named(session, tmp_path, settings, words):
    with pytest.raises(SessionError, match=words):
        drive(again(session[0], tmp_path / "again.jsonl", **settings), 20, seed=0)


def test_a_step_that_others_drove_is_a_departure(session, tmp_path):
    path, rollout = session
    first = int(rollout["next", "intervention"].squeeze(-1).nonzero()[0])
    episode, step = divmod(first + 1, 8)
    with pytest.raises(SessionError, match=f"episode {episode}, step {step}: the agent sees"):
        drive(again(path, tmp_path / "again.jsonl", switch=Never), 20, seed=0)


def test_an_action_that_was_not_recorded_is_not_made_up(session, tmp_path):
    path, rollout = session
    free = (~rollout["next", "intervention"]).squeeze(-1).nonzero()[0].item()
    words = f"did not drive step {free} of episode 0.*use switch=request"
    with pytest.raises(SessionError, match=words):
        drive(again(path, tmp_path / "again.jsonl", switch=Always), 20, seed=0)


def test_other_eyes_may_see_the_same_drive(session, tmp_path):
    path, rollout = session
    other = {"observation": {"view": "rays"}}
    with pytest.raises(SessionError, match=r"mentor.exact=false is for other observations"):
        drive(again(path, tmp_path / "refused.jsonl", **other), 20, seed=0)
    replayed = drive(again(path, tmp_path / "again.jsonl", exact=False, **other), 20, seed=0)
    assert replayed["observation"].shape != rollout["observation"].shape
    for name in ("behavior_action", "speed", "follower_gaps", "takeover_cost", "reward"):
        assert torch.equal(replayed["next", name], rollout["next", name]), name


def test_an_interrupted_replay_goes_on_with_the_next_episode(session, tmp_path):
    path, rollout = session
    target = tmp_path / "again.jsonl"
    env = again(path, target)
    env.set_seed(1)
    env.rollout(8)
    state = env.state_dict()
    env.rollout(3)
    env.close()
    other = again(path, target)
    other.load_state_dict(state)
    replayed = drive(other, 12, seed=2)
    assert (replayed["next"] == rollout["next"][8:]).all()
    assert timeless(target) == timeless(path)


def test_a_reset_in_the_middle_has_to_be_recorded(session, tmp_path):
    env = again(session[0], tmp_path / "again.jsonl")
    env.rollout(3)
    env.reset()
    env.reset()  # not yet a departure: perhaps nobody drives on
    with pytest.raises(SessionError, match="episode 0, step 3: the episode ends here"):
        env.rollout(1)
    env.close()


def test_any_gymnasium_simulator(tmp_path):
    def pendulum(mentor, switch, name):
        chain = [StepCounter(max_steps=6), InterventionTransform(mentor, switch)]
        chain.append(SessionRecorder(tmp_path / name))
        return TransformedEnv(GymEnv("Pendulum-v1"), Compose(*chain))

    def damping():
        return FunctionMentor(lambda simulator, step: (-step["observation"][2:]).clamp(-2, 2))

    rollout = drive(pendulum(damping, ActionSwitch(1.5), "first.jsonl"), 20, seed=0)
    mentor = functools.partial(ReplayMentor, tmp_path / "first.jsonl")
    replayed = drive(pendulum(mentor, RequestSwitch(), "second.jsonl"), 20, seed=1)
    assert rollout["next", "intervention"].any()
    assert (replayed["next"] == rollout["next"]).all()


def test_what_the_device_said_is_said_again(tmp_path):
    class Wheel(FunctionMentor):
        device_ok, latency_ms = False, 12.5

    def wheel():
        return Wheel(lambda simulator, step: [0.5, 0.0])

    drive(world(wheel, Always(), tmp_path / "first.jsonl"), 3, seed=0)
    drive(again(tmp_path / "first.jsonl", tmp_path / "second.jsonl"), 3, seed=0)
    (step, *_) = read_session(tmp_path / "second.jsonl").steps()
    assert (step.device_ok, step.latency_ms) == (False, 12.5)


def test_it_is_every_kind_of_mentor(session):
    mentor = ReplayMentor(session[0])
    for protocol in (RequestingMentor, ProposingMentor, StatefulMentor, DeviceMentor):
        assert isinstance(mentor, protocol)
    assert not isinstance(ExpertMentor(), (ProposingMentor, StatefulMentor, DeviceMentor))
    with pytest.raises(SessionError, match="by an InterventionTransform only"):
        mentor.act(None, None)


def test_a_missing_session_is_said_at_the_first_reset(tmp_path):
    env = again(tmp_path / "none.jsonl", tmp_path / "again.jsonl")
    with pytest.raises(SessionError, match=r"none\.jsonl does not exist"):
        env.reset()
    env.close()
