"""A run's policy as a mentor."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor

from haim_torchrl.evaluation.assembly import Sizes, World, build_actor
from haim_torchrl.evaluation.checkpoint import CheckpointError, save_checkpoint
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.config import ConfigError
from haim_torchrl.evaluation.policy_mentor import policy_mentor
from haim_torchrl.mentors import DensityMentor, Mentor


class Saved:
    """A run's folder with two policies, and an environment of its world."""

    def __init__(self, folder: Path) -> None:
        register()
        GlobalHydra.instance().clear()
        conf = Path(__file__).parents[2] / "conf"
        with initialize_config_dir(str(conf), version_base="1.3"):
            config = compose("haim", ["preset=smoke"])
        self.folder, self.env = folder, World.of(config, "train", takeovers=False)()
        self.actors: dict[str, ProbabilisticActor] = {}
        rest = OmegaConf.masked_copy(config, [key for key in config if key != "logger"])
        for name, kind in (("best", "policy"), ("last", "run")):
            actor = build_actor(config, Sizes.of(self.env), torch.device("cpu"))
            self.actors[name] = actor
            contents = {"kind": kind, "config": OmegaConf.to_yaml(rest), "frames": 100}
            path = folder / "checkpoints" / f"{name}.pt"
            save_checkpoint(path, {**contents, "actor": actor.state_dict()})

    def action(self, name: str) -> torch.Tensor:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return self.actors[name](self.start.clone())["action"]


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Saved:
    torch.manual_seed(0)
    made = Saved(tmp_path_factory.mktemp("run"))
    made.start = made.env.reset()  # type: ignore[attr-defined]
    assert not torch.equal(made.action("best"), made.action("last"))
    return made


def test_a_checkpoint_drives(saved: Saved) -> None:
    for name in ("best", "last"):
        mentor = policy_mentor(saved.folder / "checkpoints" / f"{name}.pt")
        assert isinstance(mentor, Mentor) and isinstance(mentor, DensityMentor)
        mentor.reset(saved.env)
        torch.testing.assert_close(mentor.act(saved.env, saved.start), saved.action(name))


def test_of_a_folder_the_best_policy_drives(saved: Saved) -> None:
    mentor = policy_mentor(str(saved.folder))
    torch.testing.assert_close(mentor.act(saved.env, saved.start), saved.action("best"))


def test_it_is_loaded_where_it_drives(saved: Saved) -> None:
    mentor = policy_mentor(saved.folder / "checkpoints" / "best.pt")
    twin = pickle.loads(pickle.dumps(mentor))
    torch.testing.assert_close(twin.act(saved.env, saved.start), saved.action("best"))


def test_none_is_named() -> None:
    with pytest.raises(ConfigError, match=r"mentor\.checkpoint has no value; give a run's folder"):
        policy_mentor(None)


def test_what_is_no_checkpoint_is_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="does not exist"):
        policy_mentor(tmp_path / "nowhere")
    with pytest.raises(CheckpointError, match="holds no checkpoint"):
        policy_mentor(tmp_path)


def test_a_foreign_file_is_said_when_it_is_to_drive(saved: Saved, tmp_path: Path) -> None:
    (tmp_path / "best.pt").write_bytes(b"nothing")
    mentor = policy_mentor(tmp_path / "best.pt")
    with pytest.raises(CheckpointError, match="damaged or was not written by this project"):
        mentor.act(saved.env, saved.start)
