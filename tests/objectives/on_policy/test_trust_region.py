"""Steps in a trust region, held to direct solutions and to the conditions of optimality."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from haim_torchrl.objectives.on_policy.trust_region import (
    assign,
    backtrack,
    conjugate_gradient,
    constrained_step,
    flat,
)

RADIUS = 0.02
seeds = st.integers(0, 10_000)


def problem(seed: int, size: int = 5) -> tuple[Tensor, Tensor, Tensor]:
    """A well-conditioned Fisher matrix, the objective's gradient and the cost's."""
    draw = torch.Generator().manual_seed(seed)
    root = torch.randn(size, size, generator=draw, dtype=torch.float64)
    matrix = root @ root.T + torch.eye(size, dtype=torch.float64)
    gradient, cost = torch.randn(2, size, generator=draw, dtype=torch.float64)
    return matrix, gradient, cost


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_conjugate_gradient_is_a_direct_solve(seed: int) -> None:
    matrix, right, _ = problem(seed)
    solution = conjugate_gradient(matrix.mv, right, iterations=20, tolerance=0.0)
    torch.testing.assert_close(solution, torch.linalg.solve(matrix, right))


def test_conjugate_gradient_of_nothing_is_nothing() -> None:
    matrix, right, _ = problem(0)
    assert not conjugate_gradient(matrix.mv, torch.zeros_like(right)).any()


@given(seeds, st.floats(-0.5, 0.5))
@settings(max_examples=100, deadline=None)
def test_the_step_is_optimal_or_recovers(seed: int, excess: float) -> None:
    matrix, g, b = problem(seed)
    step = constrained_step(
        g, b, torch.tensor(excess, dtype=torch.float64), matrix.inverse().mv, RADIUS
    )
    x = step.vector
    length = float(0.5 * x @ matrix @ x)
    assert length <= RADIUS * (1 + 1e-6)
    lowest = excess - float((2 * RADIUS * (b @ matrix.inverse() @ b)).sqrt())
    assert step.recovery == (lowest > 0.0)
    reached = excess + float(b @ x)
    if step.recovery:  # as low as the region reaches
        assert reached == pytest.approx(lowest)
        return
    assert reached <= 1e-9
    # Karush-Kuhn-Tucker: g = lambda H x + nu b, with nu >= 0 only where the constraint binds.
    scale = float((g - step.price * b) @ x) / (2.0 * length)
    torch.testing.assert_close(g, scale * (matrix @ x) + step.price * b, atol=1e-6, rtol=1e-6)
    assert scale > 0.0 and float(step.price) >= 0.0
    assert float(step.price) * reached == pytest.approx(0.0, abs=1e-6)


def test_a_step_by_hand() -> None:
    g, b = torch.tensor([1.0, 0.0]).double(), torch.tensor([0.0, 1.0]).double()
    # The cost lies across: it takes 0.6 of a unit circle, and 0.8 are left for the objective.
    step = constrained_step(g, b, torch.tensor(0.6, dtype=torch.float64), torch.clone, 0.5)
    torch.testing.assert_close(step.vector, torch.tensor([0.8, -0.6]).double())
    assert float(step.price) == pytest.approx(0.75)


def test_an_objective_that_is_the_cost_goes_to_the_limit_and_no_further() -> None:
    g = torch.tensor([1.0, 0.0]).double()
    step = constrained_step(g, g, torch.tensor(-0.3, dtype=torch.float64), torch.clone, 0.5)
    torch.testing.assert_close(step.vector, torch.tensor([0.3, 0.0]).double())


def test_an_inexact_solve_is_no_reason_to_recover_from_what_is_feasible() -> None:
    # b^T H^-1 b comes out a tenth of what it is, as if the edge of the cost were out of reach.
    g = torch.tensor([1.0, 0.0]).double()
    b = torch.tensor([1.0, 1e-9]).double()

    def solve(vector: Tensor) -> Tensor:
        return vector if torch.equal(vector, g) else 0.1 * vector

    for excess, expected, recovery in ((-0.5, 1.0, False), (0.5, -(0.1**0.5), True)):
        step = constrained_step(g, b, torch.tensor(excess, dtype=torch.float64), solve, 0.5)
        assert step.recovery is recovery
        assert step.vector[0].item() == pytest.approx(expected)


def test_a_cost_that_nothing_changes_is_no_constraint() -> None:
    g = torch.tensor([2.0, 0.0]).double()
    step = constrained_step(
        g, torch.zeros_like(g), torch.tensor(1.0, dtype=torch.float64), torch.clone, 0.5
    )
    torch.testing.assert_close(step.vector, torch.tensor([1.0, 0.0]).double())


def test_the_search_takes_the_first_that_will_do() -> None:
    vector, share = backtrack(torch.tensor([1.0]), lambda x: bool(x <= 0.5), shrink=0.6)
    assert share == pytest.approx(0.36) and float(vector) == pytest.approx(0.36)
    vector, share = backtrack(torch.tensor([1.0]), lambda x: False, tries=3)
    assert share == 0.0 and float(vector) == 0.0


def test_parameters_are_written_in_place() -> None:
    network = torch.nn.Linear(3, 2)
    before = [parameter.data_ptr() for parameter in network.parameters()]
    assign(network.parameters(), torch.arange(8.0))
    torch.testing.assert_close(flat(network.parameters()), torch.arange(8.0))
    assert [parameter.data_ptr() for parameter in network.parameters()] == before
