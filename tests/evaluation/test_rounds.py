"""When rounds end, and how many updates they owe."""

from __future__ import annotations

import pytest
from omegaconf import OmegaConf

from haim_torchrl.evaluation.rounds import Rounds
from haim_torchrl.evaluation.schema import DaggerConfig


def rounds(total: int = 70) -> Rounds:
    settings = DaggerConfig(warm_up=30, interactions=20, updates=7, log_every=5)
    return Rounds(OmegaConf.structured(settings), total)


def test_updates_are_due_after_the_warm_up_and_after_each_round() -> None:
    plan = rounds()
    assert plan.driven == 40
    assert [plan.advance(30), *(plan.advance(10) for _ in range(4))] == [7, 0, 7, 0, 7]
    assert plan.finished and plan.frames == 70


@pytest.mark.parametrize(
    ("frames", "done", "owed"), [(30, 0, 7), (40, 7, 0), (50, 7, 7), (50, 10, 4), (70, 21, 0)]
)
def test_what_is_owed_survives_an_interruption(frames: int, done: int, owed: int) -> None:
    plan = rounds()
    plan.load_state_dict({"frames": frames, "owed": 0.0})
    assert plan.owed(done) == owed


def test_nothing_is_owed_by_who_did_more() -> None:
    plan = rounds()
    plan.advance(30)
    assert plan.owed(100) == 0
