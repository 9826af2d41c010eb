"""Image and speed through the recipes: training, going on, evaluating, cloning, bad settings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

SEES = ("env/observation=semantic", "actor=cnn", "critic=cnn")
QUICK = (
    *("preset=smoke", "env.observation.size=21", "env.horizon=40", "eval.pictures=false"),
    *("eval.test.count=1", "actor.channels=[4,4,4]", "critic.channels=[4,4,4]"),
)


def test_a_policy_that_sees_is_trained_and_evaluated(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    schedule = ("train.checkpoint_every=200", "train.validate_every=200", "total_frames=200")
    first = command("haim", *SEES, *QUICK, *schedule, "hydra.run.dir=run")
    assert first.code == 0, first.err
    contents = torch.load(tmp_path / "run" / "checkpoints" / "last.pt", weights_only=True)
    replay = dict(contents["parts"]["replay"])
    columns = {tuple(path): rows for path, rows in replay["intervened"]["columns"]}
    assert columns["pixels",].dtype == columns["next", "pixels"].dtype == torch.uint8
    assert columns["state",].shape[1:] == (1,)
    assert len(contents["parts"]["optimizer"]["param_groups"]) == 2
    # The actor sees with what the proxy critic has learned to see with.
    kernel = next(v for k, v in contents["learner"].items() if k.endswith("layers.0.weight"))
    saved = contents["parts"]["loss"]
    twin = [v for k, v in saved.items() if "proxy.critic" in k and "encoder.layers.0.weight" in k]
    assert kernel.ndim == 4 and any(torch.equal(kernel, value) for value in twin)

    again = command("haim", "resume=run", "total_frames=400")
    assert again.code == 0, again.err
    evaluated = command(
        "evaluate", "checkpoint=run", "driver=[policy,policy+mentor]", "eval.pictures=false",
        "eval.test.count=1", "name=judged",
    )  # fmt: skip
    assert evaluated.code == 0, evaluated.err
    assert json.loads(next((tmp_path / "runs" / "judged").glob("*/metrics.json")).read_text())
    # Somebody who sees numbers is taught by one who sees images only where both are there.
    mentor = command(
        "evaluate", "driver=mentor", "mentor=policy", "mentor.checkpoint=run", SEES[0],
        "env.observation.size=21", "env.horizon=40", "eval.pictures=false", "eval.test.count=1",
    )  # fmt: skip
    assert mentor.code == 0, mentor.err


def test_cloning_trains_what_the_policy_sees_with(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    outcome = command(
        "offline", "preset=offline_smoke", *SEES[:2], "env.observation.size=21",
        "actor.channels=[4,4,4]", "steps=60", "offline.updates=4", "offline.validate_every=2",
        "hydra.run.dir=copy",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert "everything is in" in outcome.out


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ((SEES[0],), "entries pixels, state, and these networks read one vector"),
        (SEES[:2], "use those for images (actor=cnn critic=cnn)"),
        (SEES[1:], "use env/observation=semantic, or actor=tanh_normal critic=twin"),
        ((*SEES, "actor.channels=[4,4,4]"), "give both the same channels"),
        (("env.observation.view=semantic",), "choose it with env/observation=semantic"),
        ((*SEES, "env.observation.size=9"), "S at least 14"),
        ((*SEES, "env.observation.size=3"), "size: must be at least 8"),
    ],
)
def test_what_does_not_fit_ends_in_one_sentence(
    command: Callable[..., Any], overrides: tuple[str, ...], words: str
) -> None:
    outcome = command("haim", "preset=smoke", *overrides)
    assert outcome.code != 0
    assert words in outcome.err and outcome.err.count("\n") == 1
