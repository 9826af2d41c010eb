"""The offline recipe: from a dataset or from fresh driving, interrupted, resumed, refused."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra import compose, initialize_config_dir

from haim_torchrl.data.batches import DatasetBatches
from haim_torchrl.data.replay import TakeoverReplayBuffer
from haim_torchrl.evaluation.assembly import Sizes, World, build_actor
from haim_torchrl.evaluation.command import register
from haim_torchrl.evaluation.offline import EDGE, offline_data

CONF = Path(__file__).parents[2] / "conf"
SMOKE = "preset=offline_smoke"


def results(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())


def state(folder: Path, name: str = "last.pt") -> dict[str, Any]:
    return torch.load(folder / "checkpoints" / name, weights_only=True)


def assert_same_networks(first: Path, second: Path) -> None:
    one, two = state(first), state(second)
    for part in ("learner", "actor"):
        torch.testing.assert_close(one[part], two[part], rtol=0, atol=0)
    torch.testing.assert_close(one["parts"]["loss"], two["parts"]["loss"], rtol=0, atol=0)


def test_a_dataset_is_recorded_and_learned_from(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    recorded = command("demonstrate", "dataset=platoon/short-v0", "env.horizon=60", "steps=150")
    assert recorded.code == 0, recorded.err
    outcome = command(
        "offline", SMOKE, "algorithm=cql", "demonstrations=platoon/short-v0", "hydra.run.dir=run"
    )
    assert outcome.code == 0, outcome.err
    assert "dataset platoon/short-v0: 150 steps, 3 episodes" in outcome.out
    found = results(Path("run"))
    training = found["training"]
    assert (found["name"], training["frames"], training["mentor_steps"]) == ("cql", 150, 150)
    assert training["updates"] == 20 and found["checkpoint"]["frames"] in (10, 20)
    rows = (Path("run") / "train.csv").read_text().splitlines()
    assert len(rows) == 5 and "loss_cql" in rows[0] and "loss_actor" in rows[0]
    evaluated = command("evaluate", "checkpoint=run", "eval.pictures=false", "hydra.run.dir=again")
    assert evaluated.code == 0, evaluated.err
    again = results(Path("again"))["drivers"]["policy"]["episodes"]
    assert again == found["episodes"]


@pytest.mark.parametrize("algorithm", ["bc", "cql"])
def test_a_resumed_run_is_the_uninterrupted_one(
    algorithm: str, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = (SMOKE, f"algorithm={algorithm}", "offline.validate_every=20")
    whole = command("offline", *chosen, "hydra.run.dir=whole")
    assert whole.code == 0, whole.err

    sample, calls = TakeoverReplayBuffer.sample, []

    def interrupted(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 7:
            signal.raise_signal(signal.SIGINT)
        return sample(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr(TakeoverReplayBuffer, "sample", interrupted)
        first = command("offline", *chosen, "hydra.run.dir=parts")
    assert first.code == 130 and "resume=" in first.out
    assert not (Path("parts") / "metrics.json").exists()
    second = command("offline", "resume=parts")
    assert second.code == 0, second.err
    assert_same_networks(Path("whole"), Path("parts"))
    for name in ("train.csv", "validation.csv"):
        rows = [(Path(run) / name).read_text().splitlines() for run in ("whole", "parts")]
        assert len(rows[0]) == len(rows[1]) > 1
    finished = command("offline", "resume=parts")
    assert finished.code == 2 and "larger offline.updates" in finished.err


def test_as_many_steps_as_the_mentor_drove_in_a_run(
    trained: Any, command: Callable[..., Any]
) -> None:
    outcome = command("offline", SMOKE, f"like={trained.folder}", "hydra.run.dir=run")
    assert outcome.code == 0, outcome.err
    steps = state(trained.folder)["parts"]["log"]["totals"]["mentor_steps"]
    assert results(Path("run"))["training"]["mentor_steps"] == steps > 0


def test_cloning_by_likelihood(command: Callable[..., Any]) -> None:
    outcome = command("offline", SMOKE, "objective.loss_function=null", "offline.updates=5")
    assert outcome.code == 0, outcome.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["offline.updates=0"], "offline.updates must be at least 1; got 0"),
        (["offline.lr=0"], "offline.lr must be positive"),
        (["offline.policy_average=1"], "offline.policy_average must lie in [0, 1)"),
        (["offline.bc_updates=-1"], "offline.bc_updates must be at least 0"),
        (["steps=0"], "steps must be at least 1"),
        (["cost_weight=-1"], "cost_weight must be at least 0"),
        (["demonstrations=a-v0", "like=b"], "demonstrations and like are both given"),
        (["like=away"], "checkpoint away does not exist"),
        (["algorithm=cql", "objective.num_random=0"], "num_random must be at least 1"),
        (
            ["objective.loss_function=l3"],
            "objective.loss_function must be one of l1, l2, smooth_l1",
        ),
        (["algorithm=sarsa"], "Could not find 'algorithm/sarsa'"),
    ],
)
def test_bad_input(
    arguments: list[str], words: str, tmp_path: Path, command: Callable[..., Any]
) -> None:
    outcome = command("offline", SMOKE, *arguments)
    assert outcome.code == 2 and words in outcome.err
    assert len(outcome.err.strip().splitlines()) == 1
    assert list(tmp_path.rglob("*.*")) == []


def test_a_dataset_that_is_missing_is_named(
    command: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    outcome = command("offline", SMOKE, "demonstrations=platoon/away-v0")
    assert outcome.code == 2 and "dataset platoon/away-v0 is not in" in outcome.err


def test_costs_are_taken_off_the_reward_and_actions_kept_off_the_edge() -> None:
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose("offline", [SMOKE, "steps=150", "env.horizon=100", "cost_weight=7"])
    config.mentor = {"_target_": "haim_torchrl.evaluation.drivers.StraightDriver",
                     "acceleration": 1.0}  # fmt: skip
    world = World.of(config, "train", takeovers=False)
    actor = build_actor(config, Sizes.of_world(world), torch.device("cpu"))
    data = offline_data(config, world, actor, imitates=False)
    config.cost_weight = 0.0
    raw = offline_data(config, world, actor, imitates=False)
    after, cost = data["next"], data["next", "cost"]
    assert cost.sum() > 0
    torch.testing.assert_close(after["reward"], raw["next", "reward"] - 7.0 * cost)
    assert data["action"][:, 0].max().item() == pytest.approx(EDGE)


def test_batches_go_on_where_they_were() -> None:
    replay = TakeoverReplayBuffer(4, 2, keys=["observation"])
    batches = DatasetBatches(replay, 3)
    batches.load_state_dict({"drawn": 3})
    assert list(batches) == [] and batches.state_dict() == {"drawn": 3}
