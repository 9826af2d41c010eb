"""A session becomes a Minari dataset and comes back as what was collected, without any network."""

import dataclasses
import socket
import sys
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from torchrl.envs import Compose, GymEnv, StepCounter, TransformedEnv

from haim_torchrl.data import SessionError, SessionWriter, make_replay_buffer, read_session
from haim_torchrl.data.minari import MinariError, describe, export_session, load_minari, main
from haim_torchrl.envs import make_env
from haim_torchrl.evaluation.assembly import World
from haim_torchrl.evaluation.schema import register_schemas
from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import ActionSwitch, Always
from haim_torchrl.transforms import InterventionTransform, SessionRecorder, TakeoverToTransition

minari = pytest.importorskip("minari")
pytest.importorskip("h5py")

CONF = Path(__file__).parents[2] / "conf"
KEYS = [
    "observation",
    "action",
    "action_agent",
    "action_mentor",
    "intervention",
    "takeover_start",
    *(("next", key) for key in ("observation", "reward", "done", "terminated", "truncated")),
    *(("next", key) for key in ("takeover_cost", "disturbance_cost", "cost", "success")),
]


@pytest.fixture(autouse=True)
def offline(tmp_path, monkeypatch):
    """Datasets of each test are its own, and whoever wants the network is found out."""

    def refuse(*_):
        raise AssertionError("the network was asked for")

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A short real drive with expert and shield, and what was collected: episodes of 30 steps."""
    folder = tmp_path_factory.mktemp("run")
    register_schemas()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("haim", ["env.horizon=30", "eval.train.count=20"])
    world = dataclasses.replace(
        World.of(config, "train", takeovers=True),
        record={"path": folder / "session.jsonl", "seed": 3, "settings": OmegaConf.to_yaml(config)},
    )
    env = world()
    env.set_seed(3)
    torch.manual_seed(3)

    def careless(tensordict):
        return tensordict.set("action", torch.tensor([0.4, 0.3]) + 0.1 * torch.randn(2))

    rollout = env.rollout(70, careless, break_when_any_done=False)
    env.close()
    collected = TakeoverToTransition()(rollout)
    assert 0 < collected["intervention"].sum() < 70
    return folder, collected


def assert_same(loaded, collected):
    assert loaded.batch_size == collected.batch_size
    for key in KEYS:
        assert loaded[key].dtype == collected[key].dtype, key
        assert torch.equal(loaded[key], collected[key]), key


def test_a_session_comes_back_as_what_was_collected(run, tmp_path):
    session, collected = run
    folder = export_session(session, "haim/short-v0")
    assert folder == tmp_path / "datasets" / "haim" / "short-v0"
    assert_same(load_minari("haim/short-v0", make_env()), collected)
    assert_same(load_minari(folder), collected)
    assert set(load_minari(folder).keys(True, True)) == set(KEYS)


def test_what_comes_back_can_be_learned_from(run):
    export_session(run[0], "short-v0")
    replay = make_replay_buffer(100, batch_size=8)
    replay.extend(load_minari("short-v0"))
    assert len(replay) == 70
    assert replay.sample()["intervention"].sum() == 4


def test_it_is_a_minari_dataset(run):
    session, collected = run
    export_session(session, "short-v0", author="A. Driver", description="a drive")
    dataset = minari.load_dataset("short-v0")
    record = read_session(session)
    assert (dataset.total_episodes, dataset.total_steps) == (3, 70)
    metadata = dataset.storage.metadata
    assert metadata["author"] == {"A. Driver"} and metadata["description"] == "a drive"
    assert "code_permalink" not in metadata and "author_email" not in metadata
    assert f"torch=={record.header['versions']['torch']}" in metadata["requirements"]
    figures = metadata["haim_torchrl"]["statistics"]
    assert figures["mentor_share"] == pytest.approx(collected["intervention"].sum().item() / 70)
    assert figures["takeovers"] == collected["takeover_start"].sum() and figures["finished"] == 2
    ends = []
    for episode, recorded in zip(dataset, record.episodes):
        assert dataset.observation_space.contains(episode.observations[-1])
        assert dataset.action_space.contains(episode.actions[0])
        assert len(episode.observations) == len(recorded.steps) + 1
        assert all(len(values) == len(recorded.steps) + 1 for values in episode.infos.values())
        assert (episode.infos["scenario"] == recorded.scenario).all()
        assert episode.infos["device_ok"].all() and not episode.infos["intervention"][0]
        ends.append((episode.truncations[-1].item(), episode.infos["cut"][-1].item()))
    assert ends == [(True, False), (True, False), (True, True)]  # the last was cut after 10 steps
    seeds = [int(m["seed"]) for m in dataset.storage.get_episode_metadata(range(3))]
    assert seeds == [episode.scenario for episode in record.episodes]


def test_the_environment_can_be_made_again(run):
    export_session(run[0], "short-v0")
    dataset = minari.load_dataset("short-v0")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # all requirements are met here
        env = dataset.recover_environment()
    episode = dataset[1]
    observation, _ = env.reset(seed=int(episode.infos["scenario"][0]))
    assert (observation == episode.observations[0]).all()
    for action, expected in zip(episode.actions, episode.observations[1:]):
        observation, *_ = env.step(action)
        assert (observation == expected).all()
    env.close()


def test_the_commands(run, capsys, tmp_path):
    session, _ = run
    main(["export", str(session), "short-v0", "--author", "A. Driver"])
    said = capsys.readouterr().out
    assert "A. Driver" in said and "mentor_share" in said
    main(["info", "short-v0"])
    assert capsys.readouterr().out == said
    assert describe(tmp_path / "datasets" / "short-v0") + "\n" == said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["info", "away-v0"], "dataset away-v0 is not in .*; set MINARI_DATASETS_PATH"),
        (["export", "{session}", "short"], "dataset id 'short' is malformed; use name-v0"),
        (["export", "{session}", "../short-v0"], "is malformed"),
        (["export", "away", "short-v0"], "session away does not exist"),
    ],
)
def test_a_command_that_cannot_work_says_so_in_one_sentence(run, capsys, arguments, words):
    with pytest.raises(SystemExit) as error:
        main([argument.format(session=run[0]) for argument in arguments])
    assert error.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    with pytest.raises(AssertionError, match=words):
        raise AssertionError(said)


def test_nothing_is_overwritten(run, tmp_path):
    export_session(run[0], "short-v0")
    before = (tmp_path / "datasets/short-v0/data/main_data.hdf5").read_bytes()
    with pytest.raises(MinariError, match="nothing is overwritten"):
        export_session(run[0], "short-v0")
    assert (tmp_path / "datasets/short-v0/data/main_data.hdf5").read_bytes() == before


def test_a_session_that_departs_leaves_no_dataset(run, tmp_path):
    with pytest.raises(SessionError, match="the simulator is in scenario"):
        export_session(run[0], "short-v0", make_env=partial(make_env, horizon=29))
    assert not (tmp_path / "datasets" / "short-v0").exists()


@pytest.mark.parametrize("settings", [None, "a: 1"])
def test_a_session_without_its_settings_needs_an_environment(tmp_path, settings):
    with SessionWriter(tmp_path / "session.jsonl", settings=settings) as writer:
        writer.begin_episode()
        writer.add([0.0], [0.0], [0.0], intervention=False)
    with pytest.raises(MinariError, match="give make_env"):
        export_session(tmp_path / "session.jsonl", "short-v0")


def pendulum():
    return TransformedEnv(GymEnv("Pendulum-v1"), StepCounter(max_steps=6))


def test_any_gymnasium_simulator(tmp_path):
    def mentor():
        return FunctionMentor(lambda simulator, step: (-step["observation"][2:]).clamp(-2, 2))

    path = tmp_path / "session.jsonl"
    env = pendulum().append_transform(InterventionTransform(mentor, ActionSwitch(1.5)))
    env.append_transform(SessionRecorder(path))
    env.set_seed(0)
    torch.manual_seed(0)
    collected = TakeoverToTransition()(env.rollout(15, break_when_any_done=False))
    env.close()
    export_session(path, "pendulum-v0", make_env=pendulum)
    loaded = load_minari("pendulum-v0", GymEnv("Pendulum-v1"))
    for key in KEYS[:11]:
        assert torch.equal(loaded[key], collected[key]), key
    assert ("next", "success") not in loaded.keys(True)
    assert minari.load_dataset("pendulum-v0").env_spec.id == "Pendulum-v1"


def write(name="other-v0", steps=3, env="Pendulum-v1", infos=None, **changes):
    """A dataset of one episode by somebody else."""
    arrays = {
        "observations": np.zeros((steps + 1, 3), np.float32),
        "actions": np.full((steps, 1), 0.5, np.float32),
        "rewards": np.arange(steps, dtype=np.float64),
        "terminations": np.zeros(steps, bool),
        "truncations": np.arange(steps) == steps - 1,
    }
    for key, (index, value) in changes.items():
        arrays[key][index] = value
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        episode = minari.data_collector.EpisodeBuffer(**arrays, infos=infos)
        minari.create_dataset_from_buffers(name, [episode], env=env)
    return name


def test_a_dataset_of_others_counts_as_demonstrations():
    loaded = load_minari(write(), GymEnv("Pendulum-v1"))
    assert loaded["intervention"].tolist() == [[True]] * 3
    assert loaded["takeover_start"].tolist() == [[True], [False], [False]]
    for key in ("action", "action_agent", "action_mentor"):
        assert loaded[key].tolist() == [[0.5]] * 3
    following = loaded["next"]
    assert following["reward"].tolist() == [[0.0], [1.0], [2.0]]
    assert following["reward"].dtype == torch.float32
    assert following["done"].tolist() == following["truncated"].tolist() == [[False]] * 2 + [[True]]
    assert not following["terminated"].any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"observations": (0, np.nan)}, "episode 0 of .*: observation holds .* not finite"),
        ({"observations": (3, np.inf)}, r"next.observation holds values that are not finite"),
        ({"observations": (1, 2.0)}, "observation holds values .* outside of its space"),
        ({"actions": (1, np.nan)}, "action holds values that are not finite"),
        ({"actions": (1, -2.5)}, r"action holds values from -2.5 to 0.5, outside"),
        ({"rewards": (1, np.inf)}, r"next.reward holds values that are not finite"),
    ],
)
def test_a_wrong_value_is_named(changes, words):
    with pytest.raises(MinariError, match=words):
        load_minari(write(**changes))


@pytest.mark.parametrize(
    ("infos", "words"),
    [
        ({"intervention": np.ones(4, bool)}, "infos hold no action_agent"),
        (
            {
                "action_agent": np.zeros((4, 2), np.float32),
                "action_mentor": np.zeros((4, 1), np.float32),
                "intervention": np.ones(4, bool),
                "takeover_start": np.ones(4, bool),
            },
            r"action_agent has shape \(3, 2\)",
        ),
        (
            {
                "action_agent": np.zeros((4, 1), np.float32),
                "action_mentor": np.zeros((4, 1), np.float32),
                "intervention": np.ones(7, bool),
                "takeover_start": np.ones(4, bool),
            },
            "info intervention has 7 entries, not 4",
        ),
    ],
)
def test_incomplete_infos_are_named(infos, words):
    with pytest.raises(MinariError, match=words):
        load_minari(write(infos=infos))


def test_other_spaces_than_the_environments_are_named():
    write()
    with pytest.raises(MinariError, match=r"observation has shape \(3,\) in the dataset"):
        load_minari("other-v0", GymEnv("MountainCarContinuous-v0"))
    env = GymEnv("Pendulum-v1")
    env.unwrapped.action_space.high[:] = 1.0
    env.action_spec = type(env.action_spec)(low=-2.0, high=1.0, shape=(1,))
    with pytest.raises(MinariError, match=r"action has the upper bound \[2.0\] in the dataset"):
        load_minari("other-v0", env)


def test_discrete_actions_are_refused():
    arrays = {"observations": np.zeros((2, 4), np.float32), "actions": np.zeros(1, np.int64)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        episode = minari.data_collector.EpisodeBuffer(
            **arrays, rewards=[0.0], terminations=[True], truncations=[False]
        )
        minari.create_dataset_from_buffers("cart-v0", [episode], env="CartPole-v1")
    with pytest.raises(MinariError, match="action of dataset cart-v0 is Discrete"):
        load_minari("cart-v0")


def test_a_mentor_without_bounds_is_not_exported_with_wrong_values(tmp_path):
    """An agent may propose what its environment refuses; a dataset may not hold it."""
    path = tmp_path / "session.jsonl"
    takeover = InterventionTransform(lambda: FunctionMentor(lambda *_: [0.5]), Always())
    env = pendulum().append_transform(Compose(takeover, SessionRecorder(path)))
    state = env.reset()
    env.step(state.set("action", torch.tensor([9.0])))
    env.close()
    with pytest.raises(MinariError, match="action_agent holds values from 9 to 9, outside"):
        export_session(path, "short-v0", make_env=pendulum)
    assert not (tmp_path / "datasets" / "short-v0").exists()


@pytest.mark.parametrize("name", ["minari", "h5py"])
def test_what_is_not_installed_is_said(monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MinariError, match=rf"need {name}.*install haim-torchrl\[minari\]"):
        load_minari("short-v0")
