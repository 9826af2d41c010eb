"""The multiplier of a cost limit."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.objectives import LagrangeMultiplier

COSTS = st.lists(st.floats(0.0, 100.0, width=32), min_size=1, max_size=30)
GAINS = st.none() | st.tuples(*[st.floats(0.0, 10.0, width=32)] * 3).filter(any)


def test_plain_ascent_by_hand() -> None:
    multiplier = LagrangeMultiplier(1.0, initial=0.5, lr=0.1)
    found = [multiplier.update(cost).item() for cost in (3.0, 1.0, 0.0, 0.0)]
    assert found == pytest.approx([0.7, 0.7, 0.6, 0.5])


def test_pid_by_hand() -> None:
    # limit 1, P = 2, I = 0.5, D = 4
    # cost 3: excess  2, sum 1.0, no rise yet        -> 4 + 1.0     = 5.0
    # cost 4: excess  3, sum 2.5, rise 1             -> 6 + 2.5 + 4 = 12.5
    # cost 1: excess  0, sum 2.5, a fall is no rise  -> 0 + 2.5     = 2.5
    # cost 0: excess -1, sum 2.0                     -> -2 + 2.0    = 0.0
    # cost 0: excess -1, sum 1.5                     -> -2 + 1.5 < 0, hence 0
    multiplier = LagrangeMultiplier(1.0, gains=(2.0, 0.5, 4.0))
    found = [multiplier.update(cost).item() for cost in (3.0, 4.0, 1.0, 0.0, 0.0)]
    assert found == pytest.approx([5.0, 12.5, 2.5, 0.0, 0.0])
    assert multiplier.integral.item() == pytest.approx(1.5)


def test_smoothed_costs_by_hand() -> None:
    # The average is 4, then 0.75 * 4 + 0.25 * 0 = 3, then 0.75 * 3 + 0.25 * 0 = 2.25.
    multiplier = LagrangeMultiplier(1.0, gains=(1.0, 0.0, 0.0), smoothing=0.75)
    found = [multiplier.update(cost).item() for cost in (4.0, 0.0, 0.0)]
    assert found == pytest.approx([3.0, 2.0, 1.25])


@given(COSTS, GAINS, st.floats(0.0, 10.0, width=32), st.floats(0.0, 10.0, width=32))
def test_never_negative(
    costs: list[float], gains: tuple[float, float, float] | None, limit: float, initial: float
) -> None:
    multiplier = LagrangeMultiplier(limit, initial=initial, lr=0.7, gains=gains)
    for cost in costs:
        value = multiplier.update(cost)
        assert value.shape == () and value.item() >= 0.0 and multiplier.integral.item() >= 0.0


@given(COSTS, st.floats(0.0, 10.0, width=32))
def test_plain_rises_above_the_limit_and_falls_below(costs: list[float], limit: float) -> None:
    multiplier = LagrangeMultiplier(limit, initial=1.0, lr=0.5)
    for cost in costs:
        before = multiplier.value.item()
        after = multiplier.update(cost).item()
        assert after >= before if cost >= limit else after <= before
        if abs(cost - limit) > 1e-3:
            assert after != before or (before == 0.0 and cost < limit)


@given(
    st.floats(0.125, 10.0, width=32), GAINS.filter(lambda gains: gains is None or gains[1] > 0.01)
)
def test_a_lasting_excess_raises_it_every_time(
    excess: float, gains: tuple[float, float, float] | None
) -> None:
    multiplier = LagrangeMultiplier(1.0, lr=0.1, gains=gains)
    found = [multiplier.update(1.0 + excess).item() for _ in range(4)]
    assert all(later > earlier for earlier, later in pairwise(found))


def test_a_saved_one_goes_on_as_it_would_have() -> None:
    first = LagrangeMultiplier(1.0, gains=(1.0, 0.5, 2.0))
    first.update(2.0)
    second = LagrangeMultiplier(1.0, gains=(1.0, 0.5, 2.0))
    second.load_state_dict(first.state_dict())
    assert second.value.item() == first.value.item()
    assert second.update(3.0).item() == first.update(3.0).item()


def test_it_has_no_gradient() -> None:
    cost = torch.tensor([2.0], requires_grad=True)
    multiplier = LagrangeMultiplier(1.0)
    assert not multiplier.update(cost).requires_grad and not list(multiplier.parameters())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"limit": -1.0}, "limit must be a number of at least 0, got -1.0"),
        ({"limit": math.nan}, "limit must be"),
        ({"initial": -0.1}, "initial must be"),
        ({"lr": 0.0}, "lr must be a positive number"),
        ({"gains": (1.0, 2.0)}, r"gains must be three numbers"),
        ({"gains": (1.0, -2.0, 0.0)}, r"got \(1.0, -2.0, 0.0\)"),
        ({"gains": (0.0, 0.0, 0.0)}, "not all of them 0"),
        ({"smoothing": 1.0}, r"smoothing must lie in \[0, 1\)"),
    ],
)
def test_bad_settings_are_refused(arguments: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LagrangeMultiplier(**{"limit": 1.0, **arguments})  # type: ignore[arg-type]


@pytest.mark.parametrize("cost", [math.nan, math.inf])
def test_a_cost_that_is_no_number_changes_nothing(cost: float) -> None:
    multiplier = LagrangeMultiplier(1.0, initial=0.5)
    with pytest.raises(ValueError, match="mean_episode_cost must be a finite number"):
        multiplier.update(cost)
    assert multiplier.value.item() == 0.5
