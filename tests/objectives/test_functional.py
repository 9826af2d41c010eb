"""Each formula against numbers worked out by hand."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.objectives import functional


def column(*numbers: float) -> torch.Tensor:
    return torch.tensor(numbers).unsqueeze(-1)


def test_proxy_target_has_no_reward_and_takes_the_smaller_twin() -> None:
    target = functional.proxy_td_target(
        torch.tensor([[8.0, 10.0]]),
        column(-0.5),
        column(0).bool(),
        alpha=0.1,
        gamma=0.9,
    )
    # 0.9 * (8 + 0.1 * 0.5)
    torch.testing.assert_close(target, column(7.245))


def test_no_target_bootstraps_through_a_termination() -> None:
    ended = column(1).bool()
    values = torch.tensor([[float("inf"), 3.0]])
    proxy = functional.proxy_td_target(values, column(-0.5), ended, alpha=1.0, gamma=0.9)
    cost = functional.cost_td_target(column(2.0), values, ended, gamma=0.9)
    torch.testing.assert_close(proxy, column(0.0))
    torch.testing.assert_close(cost, column(2.0))


@pytest.mark.parametrize(("reduction", "expected"), [("max", 9.5), ("min", 5.0), ("mean", 7.25)])
def test_cost_target_adds_the_cost_and_no_entropy(reduction: str, expected: float) -> None:
    target = functional.cost_td_target(
        column(0.5), torch.tensor([[10.0, 5.0]]), column(0).bool(), gamma=0.9, reduction=reduction
    )
    # 0.5 + 0.9 * 10, 0.5 + 0.9 * 5, 0.5 + 0.9 * 7.5
    torch.testing.assert_close(target, column(expected))


def test_td_loss_is_half_the_square_summed_over_the_twins() -> None:
    loss = functional.td_loss(torch.tensor([[3.0, 5.0]]), column(4.0))
    torch.testing.assert_close(loss, column(1.0))  # (1 + 1) / 2


def test_td_loss_is_stationary_at_the_target() -> None:
    values = torch.full((1, 2), 4.0, requires_grad=True)
    functional.td_loss(values, column(4.0)).sum().backward()
    torch.testing.assert_close(values.grad, torch.zeros(1, 2))


def test_linear_preference_counts_interventions_only() -> None:
    agent = torch.tensor([[1.0, 2.0], [float("nan"), 7.0]])
    mentor = torch.tensor([[3.0, 3.5], [0.0, 0.0]])
    term = functional.linear_preference(agent, mentor, column(1, 0).bool())
    torch.testing.assert_close(term, column(-3.5, 0.0))  # (1 - 3) + (2 - 3.5)


def test_bounded_preference_draws_to_plus_and_minus_one() -> None:
    agent = torch.tensor([[0.0, -1.0], [5.0, 5.0]])
    mentor = torch.tensor([[3.0, 1.0], [5.0, 5.0]])
    term = functional.bounded_preference(agent, mentor, column(1, 0).bool())
    torch.testing.assert_close(term, column(2.5, 0.0))  # ((3 - 1)^2 + (0 + 1)^2) / 2


@pytest.mark.parametrize(
    ("agent", "mentor", "expected"),
    [
        ((1.0, 0.0), (0.5, 0.0), 0.0),
        ((1.0, 0.0), (0.0, 1.0), 1.0),
        ((1.0, 0.0), (-0.2, 0.0), 2.0),
        ((1.0, 1.0), (1.0, 0.0), 1.0 - math.sqrt(0.5)),
        ((0.0, 0.0), (1.0, 0.0), 0.0),
        ((1e-4, 0.0), (-1e-3, 0.0), 0.0),  # product of norms 1e-7
        ((1e-2, 0.0), (-1e-3, 0.0), 2.0),  # product of norms 1e-5
    ],
)
def test_takeover_cost(
    agent: tuple[float, float], mentor: tuple[float, float], expected: float
) -> None:
    actions = torch.tensor([agent]), torch.tensor([mentor])
    started = functional.takeover_cost(*actions, column(1).bool())
    going_on = functional.takeover_cost(*actions, column(0).bool())
    torch.testing.assert_close(started, column(expected))
    torch.testing.assert_close(going_on, column(0.0))


def test_constant_takeover_cost_is_one_at_starts() -> None:
    actions = torch.rand(3, 2), torch.rand(3, 2)
    cost = functional.constant_takeover_cost(*actions, column(1, 0, 1).bool())
    torch.testing.assert_close(cost, column(1.0, 0.0, 1.0))


@given(
    st.lists(st.floats(-1, 1, width=32), min_size=2, max_size=2),
    st.lists(st.floats(-1, 1, width=32), min_size=2, max_size=2),
    st.booleans(),
)
def test_takeover_cost_stays_between_0_and_2(
    agent: list[float], mentor: list[float], start: bool
) -> None:
    cost = functional.takeover_cost(
        torch.tensor([agent]), torch.tensor([mentor]), torch.tensor([[start]])
    )
    assert 0.0 <= cost.item() <= 2.0
    reverse = functional.takeover_cost(
        torch.tensor([mentor]), torch.tensor([agent]), torch.tensor([[start]])
    )
    torch.testing.assert_close(cost, reverse)


def test_actor_objective_weighs_critics_and_entropy() -> None:
    objective = functional.actor_objective(
        column(-0.7), [(1.0, column(3.0)), (-1.0, column(0.5)), (-2.0, column(0.25))], alpha=0.1
    )
    torch.testing.assert_close(objective, column(2.07))  # 0.07 + 3 - 0.5 - 0.5


def test_temperature_falls_while_entropy_is_above_the_target() -> None:
    log_alpha = torch.tensor(0.5, requires_grad=True)
    loss = functional.temperature_loss(log_alpha, column(-1.0), -2.0)
    torch.testing.assert_close(loss, column(1.5))  # -0.5 * (-1 - 2)
    loss.sum().backward()
    assert log_alpha.grad is not None and log_alpha.grad.item() == 3.0  # descent lowers alpha


@pytest.mark.parametrize(("reduction", "expected"), [("min", 1.0), ("max", 4.0), ("mean", 2.5)])
def test_reduce_ensemble(reduction: str, expected: float) -> None:
    values = torch.tensor([[1.0, 4.0]])
    torch.testing.assert_close(functional.reduce_ensemble(values, reduction), column(expected))


def test_unknown_reduction_is_refused() -> None:
    with pytest.raises(ValueError, match="'median'"):
        functional.reduce_ensemble(torch.zeros(1, 2), "median")


def test_flags_without_last_dimension_are_refused() -> None:
    """Broadcasting [B] against [B, 1] would silently give [B, B]."""
    with pytest.raises(ValueError, match="terminated"):
        functional.cost_td_target(
            torch.zeros(3, 1), torch.zeros(3, 2), torch.zeros(3, dtype=torch.bool), gamma=0.9
        )


def test_any_batch_shape() -> None:
    flags = torch.zeros(4, 3, 1, dtype=torch.bool)
    assert functional.td_loss(torch.zeros(4, 3, 2), torch.zeros(4, 3, 1)).shape == (4, 3, 1)
    cost = functional.takeover_cost(torch.ones(4, 3, 2), torch.ones(4, 3, 2), flags)
    assert cost.shape == (4, 3, 1)
