"""The on-policy recipe: each algorithm from end to end, resumed, imitating, and with bad input."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.config import ConfigError, check_config
from haim_torchrl.evaluation.schema import OnPolicyTrainConfig

CONF = Path(__file__).parents[2] / "conf"
SMOKE = ("preset=on_policy_smoke", "logger=csv", "eval.pictures=false", "eval.test.count=1")


def load(*overrides: str) -> DictConfig:
    register()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("on_policy", list(overrides))


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "train.csv").open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


@pytest.mark.parametrize(
    ("algorithm", "columns"),
    [
        ("ppo_rs", {"loss_objective", "loss_critic", "kl_approx"}),
        ("ppo_lag", {"loss_objective", "loss_cost_value", "multiplier", "episode_cost"}),
        ("cpo", {"loss_value", "loss_cost_value", "divergence", "recovery", "step_share"}),
    ],
)
def test_each_algorithm_runs_from_end_to_end(
    algorithm: str, columns: set[str], tmp_path: Path, command: Callable[..., Any]
) -> None:
    outcome = command("on_policy", f"algorithm={algorithm}", *SMOKE)
    assert outcome.code == 0, outcome.err
    (folder,) = (tmp_path / "runs" / algorithm).iterdir()
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["name"] == algorithm
    assert metrics["training"]["frames"] == 400
    assert metrics["training"]["mentor_steps"] == 0
    written = rows(folder)
    assert [int(row["frames"]) for row in written] == [200, 400]
    assert columns <= set(written[0])
    assert int(written[-1]["updates"]) == 4 * 2 * 2  # batches, epochs, minibatches


def test_a_resumed_run_is_the_uninterrupted_one(
    tmp_path: Path, command: Callable[..., Any]
) -> None:
    finals = []
    for name, lengths in (("whole", [400]), ("parts", [200, 400])):
        folder = None
        for length in lengths:
            again = [f"resume={folder}"] if folder else [f"name={name}", *SMOKE]
            outcome = command("on_policy", "algorithm=ppo_lag", *again, f"total_frames={length}")
            assert outcome.code == 0, outcome.err
            (folder,) = (tmp_path / "runs" / name).iterdir()
        assert folder is not None
        contents = torch.load(folder / "checkpoints" / "last.pt", weights_only=True)
        finals.append((rows(folder), contents))
    (whole, one), (parts, other) = finals
    assert whole == parts
    assert all(torch.equal(one["actor"][key], other["actor"][key]) for key in one["actor"])
    assert torch.equal(one["random"]["torch"], other["random"]["torch"])


def test_imitation_of_recorded_demonstrations(
    tmp_path: Path, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    shown = command("demonstrate", "dataset=platoon/short-v0", "env.horizon=100", "steps=150")
    assert shown.code == 0, shown.err
    outcome = command(
        "on_policy", "algorithm=gail", "demonstrations=platoon/short-v0", *SMOKE,
        "total_frames=200", "algorithm.discriminator_steps=5",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    (folder,) = (tmp_path / "runs" / "gail").iterdir()
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["name"] == "gail" and metrics["training"]["demonstrations"] == 150
    assert {"discriminator_loss", "imitation_reward", "taken_for_expert"} <= set(rows(folder)[0])


@pytest.mark.parametrize("preset", ["ppo_paper", "cpo_paper", "gail_paper", "on_policy_smoke"])
def test_presets_pass_the_checks(preset: str) -> None:
    config = load(f"preset={preset}")
    check_config(config)
    if preset.endswith("paper"):
        assert config.env.observation.view == "rays"


def test_the_paper_presets_are_the_papers_tables() -> None:
    ppo = load("preset=ppo_paper", "algorithm=ppo_lag")
    assert ppo.collector.frames_per_batch == 4000 and ppo.total_frames == 1_000_000
    assert ppo.algorithm.multiplier.limit == 1.0 and ppo.algorithm.kl_coefficient == 0.2
    assert (ppo.algorithm.epochs, ppo.algorithm.minibatch_size, ppo.algorithm.lr) == (20, 100, 5e-5)
    cpo = load("preset=cpo_paper")
    assert cpo.name == "cpo" and cpo.collector.frames_per_batch == 8000
    assert cpo.algorithm.limit == 1.0
    for config in (ppo, cpo):  # a limit of 1 per episode would not bind otherwise
        assert config.env.end_on_collision is False
    gail = load("preset=gail_paper")
    assert gail.name == "gail" and gail.collector.frames_per_batch == 12_800
    assert gail.algorithm.discriminator_steps == 2000 and gail.algorithm.discriminator_lr == 5e-3
    assert gail.demonstrations == "platoon/expert-rays-v0"
    assert gail.algorithm.max_grad_norm is ppo.algorithm.max_grad_norm is None


def test_the_files_agree_with_the_types() -> None:
    config = load()
    assert OmegaConf.to_container(config.train) == dataclasses.asdict(OnPolicyTrainConfig())
    assert config.algorithm.cost_weight == 5.0 and config.total_frames == 200_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["algorithm=gail"], "dataset platoon/expert-v0 is not in"),
        (["algorithm=gail", "demonstrations=null"], "demonstrations has no value"),
        (["demonstrations=platoon/expert-v0"], "this algorithm imitates nobody"),
        (["total_frames=450"], "use total_frames=400"),
        (["cost_limit=-1", "algorithm=cpo"], "cost_limit must be at least 0"),
        (["algorithm.cost_weight=-1"], "cost_weight must be at least 0"),
        (["algorithm.steepness=2"], "Could not override 'algorithm.steepness'"),
        (["+algorithm.steepness=2"], "unexpected keyword argument 'steepness'"),
        (["algorithm=sac"], "Could not find 'algorithm/sac'"),
    ],
)
def test_bad_settings_are_one_sentence_and_leave_nothing(
    arguments: list[str],
    words: str,
    command: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    outcome = command("on_policy", *SMOKE, *arguments)
    assert outcome.code == 2
    assert words in outcome.err
    assert len(outcome.err.strip().splitlines()) == 1
    assert list(tmp_path.rglob("*.*")) == []


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["collector=live"], "collector=live does not wait"),
        (["collector.init_random_frames=100"], "collector.init_random_frames must be 0"),
        (["record=true"], "record=true writes down who drove"),
        (["train.validate_every=0"], "eval.checkpoint=best needs validations"),
    ],
)
def test_contradictions_are_named(overrides: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        check_config(load(*overrides))
