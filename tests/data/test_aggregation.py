"""What of demonstrations and rounds is learned from, and with which weight."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from haim_torchrl.data import Aggregate, TakeoverReplayBuffer


def numbered(count: int, first: int = 0) -> TensorDict:
    """Steps whose action is their number."""
    number = torch.arange(first, first + count, dtype=torch.float32).unsqueeze(-1)
    return TensorDict({"observation": number.clone(), "action": number}, batch_size=[count])


def driven(*flags: bool, first: int = 100, doubt: bool = True) -> TensorDict:
    """Steps of a round: who drove, where takeovers began, and the doubt, a tenth of the number."""
    steps, mentor = numbered(len(flags), first), torch.tensor(flags).unsqueeze(-1)
    before = torch.cat([torch.zeros(1, 1, dtype=torch.bool), mentor[:-1]])
    steps.set("intervention", mentor).set("takeover_start", mentor & ~before)
    return steps.set("doubt", steps["action"] / 10) if doubt else steps


def aggregate(keep: str, sampling: str, size: int = 8) -> Aggregate:
    keys = ["observation", "action"]
    replay = TakeoverReplayBuffer(1000, size, sampling=sampling, keys=keys)  # type: ignore[arg-type]
    return Aggregate(replay, keep)  # type: ignore[arg-type]


def kept(data: Aggregate) -> tuple[list[float], list[float]]:
    """Numbers of the steps that count as the mentor's, and of the free ones."""
    stores = (data.replay.intervened, data.replay.free)
    return tuple(  # type: ignore[return-value]
        store.columns()["action"].flatten().tolist() if len(store) else [] for store in stores
    )


def test_hg_dagger_keeps_what_the_mentor_drove() -> None:
    data = aggregate("mentor", "uniform")
    data.add_demonstrations(numbered(3))
    data.add_round(driven(False, True, True, False, True))
    assert kept(data) == ([0.0, 1.0, 2.0, 101.0, 102.0, 104.0], [])
    data.add_round(driven(False, False, first=200))
    assert len(data) == 6


def test_iwr_keeps_all_and_counts_demonstrations_as_free() -> None:
    data = aggregate("all", "balanced")
    data.add_demonstrations(numbered(3))
    data.add_round(driven(False, True, True, False, True))
    assert kept(data) == ([101.0, 102.0, 104.0], [0.0, 1.0, 2.0, 100.0, 103.0])


def test_the_weight_of_a_takeover_by_hand() -> None:
    """Two takeover steps and eight free ones: each of the former counts four of the latter."""
    torch.manual_seed(0)
    data = aggregate("all", "balanced", size=40_000)
    data.add_demonstrations(numbered(6))
    data.add_round(driven(True, False, True, False))
    actions = data.replay.sample()["action"].flatten().long()
    frequency = torch.bincount(actions, minlength=104) / 40_000
    assert frequency[[100, 102]].sum().item() == 0.5
    assert frequency[[100, 102]].tolist() == pytest.approx([1 / 4] * 2, abs=0.01)
    free = [*range(6), 101, 103]
    assert frequency[free].tolist() == pytest.approx([1 / 16] * 8, abs=0.01)


def test_hg_dagger_weighs_each_step_the_same() -> None:
    torch.manual_seed(0)
    data = aggregate("mentor", "uniform", size=40_000)
    data.add_demonstrations(numbered(6))
    data.add_round(driven(True, False, True, False))
    actions = data.replay.sample()["action"].flatten().long()
    frequency = torch.bincount(actions, minlength=104) / 40_000
    assert frequency[[*range(6), 100, 102]].tolist() == pytest.approx([1 / 8] * 8, abs=0.01)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 20), st.lists(st.booleans(), min_size=1, max_size=30))
def test_nothing_that_the_mentor_did_is_lost(demonstrated: int, flags: list[bool]) -> None:
    data, all_steps = aggregate("mentor", "uniform"), aggregate("all", "balanced")
    for part in (data, all_steps):
        part.add_demonstrations(numbered(demonstrated))
        part.add_round(driven(*flags))
    assert len(data) == demonstrated + sum(flags)
    assert len(all_steps) == demonstrated + len(flags)
    taken = all_steps.replay.sample()["intervention"].sum().item()
    assert taken == (4 if any(flags) else 0)


def test_doubts_are_those_at_takeovers_in_their_order() -> None:
    data = aggregate("mentor", "uniform")
    data.add_demonstrations(numbered(3))
    data.add_round(driven(False, True, True, False, True))
    data.add_round(driven(True, False, first=50))
    torch.testing.assert_close(data.doubts, torch.tensor([10.1, 10.4, 5.0]))
    quiet = aggregate("all", "balanced")
    quiet.add_round(driven(True, False, doubt=False))
    assert quiet.doubts.shape == (0,)


def test_batches_of_several_environments_are_flattened() -> None:
    data = aggregate("all", "balanced")
    data.add_round(driven(True, False, False, True).reshape(2, 2))
    assert kept(data) == ([100.0, 103.0], [101.0, 102.0])


def test_demonstrations_are_not_changed() -> None:
    shown = numbered(3).set("intervention", torch.ones(3, 1, dtype=torch.bool))
    aggregate("all", "balanced").add_demonstrations(shown)
    assert shown["intervention"].all()


def test_rewards_and_costs_are_never_kept() -> None:
    """Nor read: as NaN they change nothing."""
    data = aggregate("all", "balanced")
    shown, steps = numbered(3), driven(False, True)
    for part in (shown, steps):
        nan = torch.full((len(part), 1), float("nan"))
        part.set(("next", "reward"), nan).set(("next", "cost"), nan)
    data.add_demonstrations(shown)
    data.add_round(steps)
    batch = data.replay.sample()
    assert set(batch.keys(True, True)) == {"observation", "action", "intervention"}
    assert torch.isfinite(batch["action"]).all()


def test_a_restart_keeps_data_and_doubts() -> None:
    data = aggregate("all", "balanced")
    data.add_demonstrations(numbered(3))
    data.add_round(driven(False, True, True))
    other = aggregate("all", "balanced")
    other.load_state_dict(data.state_dict())
    assert kept(other) == kept(data) and torch.equal(other.doubts, data.doubts)


def test_an_unknown_rule_is_refused() -> None:
    with pytest.raises(ValueError, match="keep must be 'mentor' or 'all', got 'some'"):
        aggregate("some", "uniform")
