"""Soft actor-critic as a recipe: reward shaping, and a limit on the cost."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from haim_torchrl.objectives import LagrangeMultiplier

SMOKE = ("preset=off_policy_smoke", "eval.pictures=false", "logger=csv")


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="") as stream:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(stream)]


def state(folder: Path) -> dict[str, Any]:
    return torch.load(folder / "checkpoints" / "last.pt", weights_only=True)


def test_reward_shaping_from_end_to_end(command: Callable[..., Any], tmp_path: Path) -> None:
    outcome = command("off_policy", *SMOKE)
    assert outcome.code == 0, outcome.err
    (folder,) = (tmp_path / "runs" / "sac_rs").iterdir()
    assert "300/300 steps" in outcome.out and "1 held-out scenarios, no mentor" in outcome.out
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["training"]["frames"] == 300 and metrics["training"]["mentor_steps"] == 0
    train = rows(folder, "train")
    assert int(train[-1]["updates"]) == 20  # a tenth of the 200 steps after the first 100
    assert {"loss_qvalue", "loss_actor", "loss_alpha", "alpha"} <= set(train[-1])
    kept = state(folder)["parts"]["replay"]
    assert not kept["intervened"]["columns"]
    assert len(rows(folder, "validation")) == 1
    evaluated = command("evaluate", f"checkpoint={folder}", "eval.set=validation", "env.horizon=30",
                        "eval.validation.count=1", "eval.pictures=false")  # fmt: skip
    assert evaluated.code == 0, evaluated.err


def test_a_resumed_run_with_a_limit_is_the_uninterrupted_one(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    lag = (*SMOKE, "algorithm=sac_lag", "train.validate_every=0", "eval.checkpoint=last",
           "train.log_every=150", "env.end_on_collision=true",
           "loss/multiplier@loss.objective.multiplier=pid")  # fmt: skip
    whole = command("off_policy", *lag, "name=whole")
    assert whole.code == 0, whole.err
    half = command("off_policy", *lag, "name=half", "total_frames=150")
    assert half.code == 0, half.err
    one, other = (next((tmp_path / "runs" / name).iterdir()) for name in ("whole", "half"))
    gone_on = command("off_policy", f"resume={other}", "total_frames=300")
    assert gone_on.code == 0, gone_on.err
    assert rows(one, "train") == rows(other, "train")
    for part in ("learner", "actor"):
        for name, value in state(one)[part].items():
            assert torch.equal(value, state(other)[part][name]), name
    losses = [state(folder)["parts"]["loss"] for folder in (one, other)]
    assert losses[0].keys() == losses[1].keys()
    assert all(torch.equal(losses[0][name], losses[1][name]) for name in losses[0])
    assert torch.isfinite(losses[0]["multiplier.previous_cost"])  # an episode has moved it
    assert "multiplier" in rows(one, "train")[-1]
    new = ("optimizer.lr=1e-5", "loss.gamma=0.5", "algorithm=sac_lag",
           "loss.objective.multiplier.limit=7")  # fmt: skip
    changed = command("off_policy", f"resume={other}", "total_frames=350", *new)
    assert changed.code == 0, changed.err
    parts = state(other)["parts"]
    assert {group["lr"] for group in parts["optimizer"]["param_groups"]} == {1e-5}
    assert float(parts["loss"]["_value_estimator.gamma"]) == 0.5


def test_the_price_of_the_cost_moves_once_there_is_learning(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    moved: list[float] = []
    monkeypatch.setattr(LagrangeMultiplier, "update", lambda _, cost: moved.append(cost))
    # An episode of at most 50 steps ends in each of 6 batches of 50; the last one is learned from.
    outcome = command("off_policy", *SMOKE, "algorithm=sac_lag", "train.learning_starts=250",
                      "env.horizon=50", "train.validate_every=0",
                      "eval.checkpoint=last")  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert len(moved) == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["algorithm=sac_lag", "loss.objective.multiplier.limit=-1"],
         "limit must be a number of at least 0, got -1"),
        (["algorithm=sac_lag", "loss.objective.multiplier.gains=[1,2]"],
         "gains must be three numbers"),
        (["loss.cost_weight=-1"], "loss.cost_weight must be a number of at least 0; got -1"),
        (["loss.objective.num_qvalue_nets=none"], "loss.objective cannot be built"),
        (["loss.gamma=2"], "loss.gamma must lie in [0, 1]; got 2"),
        (["loss.tau=0"], "loss.tau must lie in (0, 1]; got 0"),
        (["loss=haim"], "loss has no objective of soft actor-critic"),
        (["collector=live"], "collector=live drives in real time for a person"),
        (["record=true"], "here nobody takes over"),
        (["algorithm=sac_cpo"], "Could not find 'algorithm/sac_cpo'"),
        (["env/observation=semantic", "actor=cnn", "critic=cnn"],
         "actor=cnn sees with the encoder of a critic"),
    ],
)  # fmt: skip
def test_bad_settings_are_one_sentence_and_leave_nothing(
    arguments: list[str], words: str, command: Callable[..., Any], tmp_path: Path
) -> None:
    outcome = command("off_policy", *SMOKE, *arguments)
    assert outcome.code == 2
    assert words in outcome.err
    lines = outcome.err.strip().splitlines()
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert list(tmp_path.rglob("*.*")) == []


def test_a_loss_without_takeovers_is_refused_where_a_mentor_drives(
    command: Callable[..., Any],
) -> None:
    outcome = command("haim", "preset=smoke", "loss=sac_rs")
    assert outcome.code == 2 and "none of the terms of a method" in outcome.err
