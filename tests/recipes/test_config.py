"""Every setting composes, finds its target, and is a setting of that target."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.utils import get_object
from omegaconf import DictConfig, OmegaConf

from haim_torchrl.data import Reflection
from haim_torchrl.envs import PlatoonConfig
from haim_torchrl.envs.semantic import SemanticConfig
from haim_torchrl.evaluation.assembly import Sizes, World, build, build_actor
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.config import (
    ConfigError,
    check_config,
    find_device,
    plain,
)
from haim_torchrl.evaluation.offline import check_offline
from haim_torchrl.evaluation.schema import EvalConfig, OfflineConfig, TrainConfig
from haim_torchrl.evaluation.terms import build_loss
from haim_torchrl.modules import make_critic

CONF = Path(__file__).parents[2] / "conf"
FILES = sorted(path.relative_to(CONF) for path in CONF.rglob("*.yaml"))
MEMBERS = [path for path in FILES if len(path.parts) > 1]


@functools.cache
def _composed(name: str, *overrides: str) -> DictConfig:
    register()
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose(name, list(overrides))


def load(*overrides: str, name: str = "haim") -> DictConfig:
    return _composed(name, *overrides).copy()


def changed(*overrides: str) -> DictConfig:
    """The default settings with values replaced; faster than composing anew."""
    return OmegaConf.merge(load(), OmegaConf.from_dotlist(list(overrides)))  # type: ignore[return-value]


def targets(node: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(node, dict):
        if "_target_" in node:
            yield path, node
        for key, value in node.items():
            yield from targets(value, f"{path}.{key}" if path else key)
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from targets(value, f"{path}[{index}]")


OTHERS = {
    "dagger": {
        "algorithm": ("hg_dagger", "iwr"),
        "preset": ("dagger_default", "dagger_paper", "dagger_smoke"),
    },
    "off_policy": {
        "algorithm": ("sac_rs", "sac_lag"),
        "loss": ("sac_rs", "sac_lag"),
        "preset": ("off_policy", "off_policy_smoke", "sac_paper", "sac_lag_paper"),
    },
    "on_policy": {
        "algorithm": ("ppo_rs", "ppo_lag", "cpo", "gail"),
        "discriminator": ("mlp",),
        "preset": ("on_policy_default", "on_policy_smoke", "ppo_paper", "cpo_paper", "gail_paper"),
        "value": ("mlp",),
    },
    "offline": {
        "algorithm": ("bc", "cql"),
        "preset": ("offline_default", "offline_smoke", "bc_paper", "cql_paper"),
    },
}
"""Members of groups that belong to another recipe than the main one."""


def recipe_of(path: Path) -> str:
    """The recipe that a member of a group is meant for."""
    for recipe, groups in OTHERS.items():
        if path.stem in groups.get(str(path.parent), ()):
            return recipe
    return "haim"


def composed(path: Path) -> DictConfig:
    if path.parts[0] == "logger":  # their folder is known to a running job only
        return OmegaConf.load(CONF / path)  # type: ignore[return-value]
    if len(path.parts) > 2 and path.parts[0] == "mentor":  # groups that only people have
        return load("mentor=keyboard", f"{path.parent}={path.stem}")
    if path.parent == Path("loss/multiplier"):
        member = f"loss/multiplier@loss.objective.multiplier={path.stem}"
        return load("algorithm=sac_lag", member, name="off_policy")
    lag = ["algorithm=sac_lag"] if path.stem == "sac_lag_paper" else []
    return load(*lag, f"{path.parent}={path.stem}", name=recipe_of(path))


@pytest.mark.parametrize("path", MEMBERS, ids=str)
def test_member_composes_and_its_keys_are_parameters_of_its_target(path: Path) -> None:
    config = composed(path)
    container = OmegaConf.to_container(config, resolve=False)
    found = [entry for entry in targets(container) if not entry[0].startswith("logger")]
    assert found or path.parts[0] in ("preset", "logger")
    for where, node in found:
        target = get_object(node["_target_"])
        parameters = inspect.signature(target).parameters
        if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values()):
            continue
        given = {key for key in node if not (key.startswith("_") and key.endswith("_"))}
        assert given <= set(parameters), f"{path}: {where} has {given - set(parameters)}"


@pytest.mark.parametrize("path", FILES, ids=str)
def test_every_file_says_what_it_is(path: Path) -> None:
    lines = (CONF / path).read_text().splitlines()
    comments = [line for line in lines[:3] if line.startswith("# ") and "@package" not in line]
    assert comments, f"{path} does not begin with a comment"


@pytest.mark.parametrize(
    "name", ["haim", "dagger", "demonstrate", "offline", "evaluate", "off_policy", "on_policy"]
)
def test_recipe_settings_pass_the_checks(name: str) -> None:
    check_config(load(name=name))


@pytest.mark.parametrize("algorithm", ["bc", "cql"])
def test_an_offline_algorithm_names_its_runs(algorithm: str) -> None:
    config = load(f"algorithm={algorithm}", name="offline")
    assert config.name == algorithm
    check_offline(config)
    assert OmegaConf.to_container(config.offline) == dataclasses.asdict(OfflineConfig())


def test_offline_paper_presets_are_the_papers_tables() -> None:
    bc, cql = load("preset=bc_paper", name="offline"), load("preset=cql_paper", name="offline")
    assert (bc.name, bc.offline.batch_size, bc.offline.updates) == ("bc", 32, 200_000)
    assert cql.name == "cql" and (cql.loss.gamma, cql.loss.tau) == (0.99, 0.005)
    assert (cql.objective.temperature, cql.objective.min_q_weight) == (5.0, 0.2)
    assert cql.offline.bc_updates == 200_000
    assert bc.offline.lr == cql.offline.lr == 1e-4
    assert cql.env.horizon == 1500
    for config in (bc, cql):
        check_offline(config)
        assert config.demonstrations == "platoon/expert-rays-v0"
        assert config.env.observation.view == "rays"


@pytest.mark.parametrize("preset", ["default", "paper", "smoke"])
def test_presets_pass_the_checks(preset: str) -> None:
    check_config(load(f"preset={preset}"))


def test_the_files_agree_with_the_types() -> None:
    config = load()
    default = dataclasses.asdict(TrainConfig())
    assert OmegaConf.to_container(config.train) == default
    evaluation = dataclasses.asdict(EvalConfig())
    for name in ("train", "validation", "test"):
        evaluation.pop(name)
    assert {key: config.eval[key] for key in evaluation} == evaluation


def test_the_world_shows_all_its_settings() -> None:
    env = plain(load().env)
    given = {key for key in env if not key.startswith("_")} | {"first_scenario", "scenarios"}
    assert given == {f.name for f in dataclasses.fields(PlatoonConfig)}
    default = PlatoonConfig()
    for part in ("scenario", "observation", "idm"):
        names = {f.name for f in dataclasses.fields(getattr(default, part))}
        assert set(env[part]) == names, part


def test_the_image_shows_all_its_settings() -> None:
    seen = plain(load("env/observation=semantic").env.observation)
    assert seen.pop("view") == "semantic"
    assert set(seen) == {f.name for f in dataclasses.fields(SemanticConfig)}


def test_observations_are_a_group_inside_the_world() -> None:
    assert load("env/observation=rays") == load("env.observation.view=rays")
    paper = load("preset=paper", "env/observation=semantic", "env.observation.size=84")
    assert PlatoonConfig.of({"observation": plain(paper.env.observation)}).observation == (
        SemanticConfig(84, 40.0, 20.0)
    )


def test_paper_preset_is_the_papers_table() -> None:
    config = load("preset=paper")
    assert config.train.batch_size == 1024
    assert config.optimizer.lr == 1e-4
    assert config.train.learning_starts == 100
    assert config.collector.frames_per_batch == 100
    assert config.loss.gamma == 0.99 and config.loss.tau == 0.005
    assert config.loss.preference.term._target_.endswith("LinearPreferenceLoss")
    assert config.loss.preference.term.weight == 10.0
    assert config.loss.proxy.term.actor_weight == 1.0
    assert config.loss.explicit.term.actor_weight == -1.0
    assert config.loss.implicit.term.actor_weight == -1.0
    assert config.loss.implicit.cost.threshold == -5.0
    assert config.loss.implicit.cost.duration == 10.0
    assert config.loss.entropy.temperature.learnable
    assert config.replay.sampling == "uniform"
    assert config.env.horizon == 1000 and config.env.followers == 5
    assert config.env.follower_gap == 15.0 and config.env.observation.view == "rays"
    assert dict(config.env.idm) == {
        "s0": 5.0,
        "time_headway": 1.0,
        "max_acceleration": 4.0,
        "comfortable_deceleration": 4.0,
        "desired_speed": 15.0,
        "exponent": 4.0,
    }


def test_sac_presets_are_the_papers_table() -> None:
    config = load("algorithm=sac_lag", "preset=sac_lag_paper", name="off_policy")
    check_config(config)
    assert config.loss.gamma == 0.99 and config.loss.tau == 0.005
    assert config.optimizer.lr == 1e-4 and config.env.horizon == 1500
    assert config.train.learning_starts == 10_000 and config.total_frames == 1_000_000
    assert config.loss.objective.multiplier.limit == 1.0
    assert config.env.end_on_collision is False
    plain = load("preset=sac_paper", name="off_policy")
    assert plain.loss.objective._target_ == "torchrl.objectives.SACLoss"
    assert (plain.name, config.name) == ("sac_rs", "sac_lag")


def test_a_group_on_the_command_line_beats_the_preset() -> None:
    config = load("preset=paper", "loss/preference=bounded", "loss.preference.term.weight=2")
    assert config.loss.preference.term._target_.endswith("BoundedPreferenceLoss")
    assert config.loss.preference.term.weight == 2


@pytest.mark.parametrize(
    "group",
    [
        "switch",
        "mentor",
        "env",
        "env/observation",
        "loss/implicit",
        "loss/explicit",
        "replay",
        "optimizer",
    ],
)
def test_every_member_can_be_built(group: str) -> None:
    for path in sorted((CONF / group).glob("*.yaml")):
        config = load(f"{group}={path.stem}")
        if path.stem.startswith("metadrive"):
            if importlib.util.find_spec("metadrive") is None:
                continue
            config = load("env=metadrive", *([] if group == "env" else [f"{group}={path.stem}"]))
        if path.stem == "policy":
            with pytest.raises(ConfigError, match=r"mentor\.checkpoint has no value"):
                build(config.mentor)
        elif group in ("switch", "mentor"):
            assert build(config[group]) is not None
        elif group == "replay":
            mirror = Reflection((1, 0), (1.0, 1.0), (1.0, -1.0))
            assert len(build(config.replay, batch_size=4, reflection=mirror)) == 0
        elif group == "optimizer":
            actor = build_actor(config, Sizes(5, 2), torch.device("cpu"))
            loss = build_loss(config.loss, actor, lambda: make_critic(5, 2, (8,)))
            assert build(config.optimizer, loss).param_groups
        elif path.stem == "carla":  # needs a server; tests/envs/carla has one that stands in
            nobody = load("env=carla", "env.ports=[1]", "env.timeout=0.3")
            with pytest.raises(ConfigError, match=r"no CARLA server answered|env=carla needs"):
                World.of(nobody, "validation", takeovers=True)()
        else:
            env = World.of(config, "validation", takeovers=True)()
            assert "disturbance_cost" in env.observation_spec
            env.close()


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["eval.test.start=10"], "eval.train and eval.test share the scenarios 10 to 49"),
        (["eval.validation.start=20010"], "eval.validation and eval.test share"),
        (["eval.validation.start=49"], "eval.train and eval.validation share the scenarios 49"),
        (["eval.test.count=0"], "eval.test must have"),
        (["train.batch_size=0"], "train.batch_size must be at least 1"),
        (["train.updates_per_step=0"], "train.updates_per_step must be positive"),
        (["train.max_grad_norm=0"], "train.max_grad_norm must be positive"),
        (["train.learning_starts=30000"], "nothing is ever learned"),
        (["train.validate_every=0"], "eval.checkpoint=best needs validations"),
        (["total_frames=30050"], "use total_frames=30000"),
        (["collector.frames_per_batch=0"], "collector.frames_per_batch must lie between"),
        (["replay.capacity=100"], "replay.capacity"),
        (["threads=0"], "threads must be at least 1"),
        (["device=tpu"], "device must be cpu, cuda or auto"),
        (["eval.level=95"], "eval.level"),
        (["eval.set=tests"], "eval.set must be one of test, validation, train"),
        (["eval.workers=0"], "eval.workers"),
    ],
)
def test_contradictions_are_named(overrides: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        check_config(changed(*overrides))


def test_a_brake_that_the_vehicle_has_not_is_named() -> None:
    config = changed("loss.implicit.cost.threshold=-9")
    with pytest.raises(ConfigError, match=r"threshold is -9(\.0)? m/s², but the vehicle brakes"):
        World.of(config, "train", takeovers=True)()


def test_nobody_to_disturb_is_named() -> None:
    with pytest.raises(ConfigError, match="followers: must be between 1 and 5"):
        World.of(changed("env.followers=0"), "train", takeovers=True)()


def test_auto_device_is_one_that_exists() -> None:
    expected = "cuda" if torch.cuda.is_available() else "cpu"
    assert find_device("auto").type == expected


def test_methods_are_bundles_of_groups() -> None:
    assert load("method=haim") == load()
    assert load("method=pvp").loss == load("loss=pvp").loss
    assert load("method=sparse").switch.steps == 30
    assert load("method=constant").loss.explicit.cost == "constant"
    assert load("method=pvp", "loss/preference=linear").loss.preference.term.weight == 10.0


def test_the_ablation_is_the_default_run_for_every_method_and_seed() -> None:
    ablation = load(name="ablation")
    assert ablation.resume == "auto"
    assert OmegaConf.merge(ablation, {"resume": None}) == load()
    methods = {path.stem for path in (CONF / "method").glob("*.yaml")}
    assert {load(f"method={method}").name for method in methods} == methods
    raw = OmegaConf.load(CONF / "ablation.yaml")
    assert set(raw.hydra.sweeper.params.method.split(",")) == methods  # type: ignore[union-attr]
