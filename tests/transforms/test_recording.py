"""What is driven is what is written, and driving does not notice."""

import os

import cloudpickle
import pytest
import torch
from torchrl.envs import Compose, GymEnv, ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.llm.transforms.policy_version import PolicyVersion

from haim_torchrl.data import SessionError, read_session
from haim_torchrl.data.session import fingerprint
from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import ActionSwitch, Always, Hold
from haim_torchrl.transforms import InterventionTransform, SessionRecorder


def drive(env, steps=20, seed=0):
    env.set_seed(seed)
    torch.manual_seed(seed)
    return env.rollout(steps, break_when_any_done=False)


@pytest.fixture
def recorded(pendulum, tmp_path):
    """Builds a pendulum that is recorded, with episodes of seven steps."""

    def build(path=tmp_path / "session.jsonl", switch=None, mentor=None, **options):
        recorder = SessionRecorder(path, **options)
        switch = switch or Hold(ActionSwitch(2.0), 2)
        return pendulum(switch, 7, mentor=mentor, after=[recorder])

    return build


def test_the_file_holds_what_was_published(recorded, tmp_path):
    env = recorded(seed=0, settings="a: 1")
    rollout = drive(env)
    env.close()
    session = read_session(tmp_path / "session.jsonl")
    assert (session.header["seed"], session.header["settings"]) == (0, "a: 1")
    assert [len(episode.steps) for episode in session.episodes] == [7, 7, 6]
    following = rollout["next"]
    assert following["intervention"].any() and not following["intervention"].all()
    for index, step in enumerate(session.steps()):
        row = following[index]
        assert (step.episode, step.step) == divmod(index, 7)
        assert torch.equal(torch.tensor(step.action_agent), row["action_agent"])
        assert torch.equal(torch.tensor(step.action_mentor), row["action_mentor"])
        assert torch.equal(torch.tensor(step.action), row["behavior_action"])
        for name in ("intervention", "takeover_start", "done"):
            assert getattr(step, name) == row[name].item()
        assert step.observation == fingerprint(rollout[index]["observation"].numpy())
        assert step.scenario is None and step.device_ok and step.latency_ms is None


def test_the_generators_state_makes_the_episode_again(recorded, tmp_path):
    env = recorded()
    rollout = drive(env, 14)
    env.close()
    second = read_session(tmp_path / "session.jsonl").episodes[1]
    gym = GymEnv("Pendulum-v1")
    gym.set_seed(5)
    gym._env.unwrapped.np_random.bit_generator.state = second.random_state
    assert torch.equal(gym.reset()["observation"], rollout["observation"][7])


def test_recording_changes_nothing(pendulum, recorded):
    plain, written = drive(pendulum(Hold(ActionSwitch(2.0), 2), 7)), drive(recorded())
    assert (plain == written).all()
    assert set(plain.keys(True, True)) == set(written.keys(True, True))


def test_a_reset_alone_is_no_episode(recorded, tmp_path):
    path = tmp_path / "session.jsonl"
    env = recorded()
    for _ in range(3):
        env.reset()
    assert not path.exists()
    env.rollout(2)
    env.reset()
    env.close()
    assert [len(episode.steps) for episode in read_session(path).episodes] == [2]


def test_an_environment_goes_on_with_its_session(recorded, tmp_path):
    path = tmp_path / "session.jsonl"
    env = recorded()
    assert env.state_dict() is not None and not path.exists()
    drive(env, 9)
    state = env.state_dict()
    before = list(read_session(path).steps())
    drive(env, 5, seed=1)
    env.close()
    assert len(read_session(path)) == 14
    other = recorded()
    other.load_state_dict(state)
    drive(other, 3, seed=2)
    other.close()
    session = read_session(path)
    assert list(session.steps())[:9] == before
    assert [len(episode.steps) for episode in session.episodes] == [7, 2, 3]


def test_a_session_cannot_go_on_from_elsewhere(recorded, tmp_path):
    env = recorded()
    drive(env, 9)
    state = env.state_dict()
    env.close()
    (tmp_path / "session.jsonl").rename(tmp_path / "away.jsonl")
    with pytest.raises(SessionError, match="is gone"):
        recorded().load_state_dict(state)


def test_another_session_is_not_overwritten(recorded):
    first, second = recorded(), recorded()
    drive(first, 1)
    with pytest.raises(FileExistsError, match="nothing is overwritten"):
        drive(second, 1)
    first.close()


def test_each_worker_has_a_file(recorded, tmp_path):
    here = os.getpid()

    def build():
        return recorded(process=here)

    env = ParallelEnv(2, build, mp_start_method="fork")
    env.rollout(3)
    env.close()
    files = sorted(tmp_path.glob("session-*.jsonl"))
    assert len(files) == 2 and not (tmp_path / "session.jsonl").exists()
    assert [len(read_session(file)) for file in files] == [3, 3]


def test_devices_and_versions_are_noted(tmp_path):
    class Wheel(FunctionMentor):
        device_ok, latency_ms = False, 12.5

    path = tmp_path / "session.jsonl"
    takeover = InterventionTransform(lambda: Wheel(lambda simulator, step: [1.0]), Always())
    chain = Compose(takeover, SessionRecorder(path), PolicyVersion())
    env = TransformedEnv(GymEnv("Pendulum-v1"), chain)
    env.rollout(2)
    env.close()
    for step in read_session(path).steps():
        assert (step.device_ok, step.latency_ms, step.policy_version) == (False, 12.5, 0)


def test_it_needs_somebody_to_record(tmp_path):
    recorder = SessionRecorder(tmp_path / "session.jsonl")
    with pytest.raises(RuntimeError, match="there is none before it"):
        TransformedEnv(GymEnv("Pendulum-v1"), recorder).rollout(1)
    takeover = InterventionTransform(lambda: FunctionMentor(lambda *_: [1.0]), Always())
    before = Compose(SessionRecorder(tmp_path / "session.jsonl"), takeover)
    with pytest.raises(RuntimeError, match="there is none before it"):
        TransformedEnv(GymEnv("Pendulum-v1"), before).rollout(1)
    with pytest.raises(RuntimeError, match="SessionRecorder needs the simulator"):
        TransformedEnv(
            SerialEnv(2, lambda: GymEnv("Pendulum-v1")), SessionRecorder(tmp_path / "x.jsonl")
        )


def test_it_travels_without_its_file(recorded, tmp_path):
    env = recorded()
    drive(env, 2)
    copies = (env.transform[-1].clone(), cloudpickle.loads(cloudpickle.dumps(env)).transform[-1])
    for twin in copies:
        assert twin.path == tmp_path / "session.jsonl"
        assert bytes(twin.get_extra_state().tolist()) == b'{"file": null, "steps": 0}'
    env.close()
