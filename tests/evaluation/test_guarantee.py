"""Theorem 1 against the exact value of small decision processes with a mentor."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from haim_torchrl.evaluation.guarantee import failure_bound
from haim_torchrl.switches import ProbabilitySwitch, Situation

ROUNDING = 1e-9
RATES = st.floats(0.0, 1.0)
ARGUMENTS = st.tuples(RATES, RATES, st.floats(0.0, 10.0), st.floats(0.0, 0.99))


@dataclass(frozen=True)
class Task:
    """States and actions in tables: next states [S, A, S], everything else [S, A]."""

    transitions: np.ndarray
    failure: np.ndarray  # C(s, a), the probability of a failure
    mentor: np.ndarray  # what the mentor does after a takeover
    takeover: np.ndarray  # I(s, a), the probability of a takeover
    gamma: float

    @property
    def rates(self) -> tuple[float, float, float, float]:
        """The arguments of the bound by their definitions, each in its worst state."""
        passed = 1.0 - self.takeover
        epsilon = (self.mentor * self.failure).sum(-1).max()
        kappa = (passed * self.failure).sum(-1).max()
        return epsilon, kappa, passed.sum(-1).max(), self.gamma

    def mixed(self, agent: np.ndarray) -> np.ndarray:
        """The behaviour policy of one agent or a batch of them, [..., S, A]."""
        taken = (agent * self.takeover).sum(-1, keepdims=True)
        return agent * (1.0 - self.takeover) + taken * self.mentor

    def value(self, policy: np.ndarray) -> np.ndarray:
        """V = c + gamma P V, solved: [..., S, A] gives [..., S]."""
        step = np.einsum("...sa,sat->...st", policy, self.transitions)
        cost = (policy * self.failure).sum(-1)
        return np.linalg.solve(np.eye(len(self.failure)) - self.gamma * step, cost[..., None])[
            ..., 0
        ]

    def worst(self) -> float:
        """Highest value over all deterministic agents (hence over all agents) and states."""
        states, actions = self.failure.shape
        choices = list(itertools.product(range(actions), repeat=states))
        return float(self.value(self.mixed(np.eye(actions)[choices])).max())


def random_task(seed: int, states: int, actions: int, gamma: float, error: float) -> Task:
    """Failures yes or no; the mentor errs and overlooks with at most ``error`` in each state."""
    rng = np.random.default_rng(seed)
    transitions = rng.dirichlet(np.full(states, 0.3), size=(states, actions))
    failure = (rng.random((states, actions)) < 0.5).astype(float)
    failure[:, 0] = 0.0  # something safe to do is left in each state
    unsafe = failure * rng.random((states, actions))
    unsafe /= np.maximum(unsafe.sum(-1, keepdims=True), 1e-12)
    safe = (1.0 - failure) * rng.dirichlet(np.ones(actions), size=states)
    safe /= safe.sum(-1, keepdims=True)
    slips, misses = error * rng.random((2, states, 1))
    mentor = np.where(unsafe.any(-1, keepdims=True), slips * unsafe + (1 - slips) * safe, safe)
    needless = rng.random((states, actions)) < 0.3  # takeovers from safe actions
    takeover = np.where(failure == 1.0, 1.0 - misses * unsafe, needless)
    return Task(transitions, failure, mentor, takeover, gamma)


TASKS = st.builds(
    random_task,
    seed=st.integers(0, 2**32 - 1),
    states=st.integers(1, 4),
    actions=st.integers(2, 4),
    gamma=st.sampled_from([0.0, 0.5, 0.9, 0.99]),
    error=st.sampled_from([0.0, 0.01, 0.1, 0.5, 1.0]),
)


@settings(max_examples=300, deadline=None)
@given(TASKS, st.integers(0, 2**32 - 1))
def test_no_agent_exceeds_the_bound(task: Task, seed: int) -> None:
    epsilon, kappa, _, gamma = task.rates
    agents = np.random.default_rng(seed).dirichlet(
        np.full(task.failure.shape[1], 0.5), size=(8, len(task.failure))
    )
    worst = task.worst()
    assert task.value(task.mixed(agents)).max() <= worst + ROUNDING
    assert worst <= failure_bound(*task.rates) + ROUNDING
    assert worst <= failure_bound(*task.rates, literal=True) + ROUNDING
    assert worst <= failure_bound(epsilon, kappa, 0.0, gamma) + ROUNDING
    assert worst <= (epsilon + kappa - epsilon * kappa) / (1.0 - gamma) + ROUNDING


@settings(max_examples=100, deadline=None)
@given(TASKS, st.integers(0, 2**32 - 1))
def test_performance_difference(task: Task, seed: int) -> None:
    """Lemma 1 holds for V without a factor of 1 - gamma, and the normalised state distribution."""
    states, actions = task.failure.shape
    mixed = task.mixed(np.random.default_rng(seed).dirichlet(np.ones(actions), size=states))
    mentor_value = task.value(task.mentor)
    advantage = task.failure + task.gamma * task.transitions @ mentor_value - mentor_value[:, None]
    step = np.einsum("sa,sat->st", mixed, task.transitions)
    visits = (1.0 - task.gamma) * np.linalg.inv(np.eye(states) - task.gamma * step)
    gain = visits @ (mixed * advantage).sum(-1) / (1.0 - task.gamma)
    assert visits.sum(-1) == pytest.approx(np.ones(states))
    assert task.value(mixed) == pytest.approx(mentor_value + gain, abs=1e-9)


class TableMentor:
    """A mentor that knows its probabilities, [S, A]; relative to its likeliest action."""

    def __init__(self, policy: np.ndarray) -> None:
        self.policy = policy

    def reset(self, simulator: object) -> None: ...

    def act(self, simulator: object, tensordict: TensorDict) -> torch.Tensor:
        return torch.tensor([self.policy[int(tensordict["observation"])].argmax()])

    def density(self, simulator: object, tensordict: TensorDict, action: torch.Tensor) -> float:
        row = self.policy[int(tensordict["observation"])]
        return float(row[int(action)] / row.max())


def switched(mentor: TableMentor, eta: float) -> np.ndarray:
    """Which actions :class:`ProbabilitySwitch` takes over from, [S, A]."""
    states, actions = mentor.policy.shape
    switch = ProbabilitySwitch(eta)
    table = np.zeros((states, actions))
    for state, action in itertools.product(range(states), range(actions)):
        observation = TensorDict({"observation": torch.tensor(state)})
        proposal = torch.tensor([action])
        table[state, action] = switch(Situation(None, observation, proposal, mentor, False))
    return table


@pytest.mark.parametrize("seed", range(20))
def test_definition_1_as_the_switch(seed: int) -> None:
    """A mentor that avoids risk. A lower eta tolerates more, and the bound rises."""
    rng = np.random.default_rng(seed)
    failure = rng.random((3, 4)) / 4  # risks, so that the tolerated ones sum to less than 1
    mentor = np.exp(-20.0 * failure)
    mentor /= mentor.sum(-1, keepdims=True)
    transitions = rng.dirichlet(np.full(3, 0.3), size=(3, 4))
    bounds = []
    for eta in (1.0, 0.5, 0.1, 1e-9):
        takeover = switched(TableMentor(mentor), eta)
        task = Task(transitions, failure, mentor, takeover, 0.9)
        assert task.worst() <= failure_bound(*task.rates) + ROUNDING
        bounds.append(failure_bound(*task.rates))
    assert task.rates[2] == 4  # nothing is taken over from any more
    assert bounds == sorted(bounds) and bounds[0] < bounds[-1]


def one_state(failure: list[float], mentor: list[float], takeover: list[float]) -> Task:
    tables = (np.array([row]) for row in (failure, mentor, takeover))
    return Task(np.ones((1, len(failure), 1)), *tables, gamma=0.9)


def test_one_state_by_hand() -> None:
    """Action 0 is safe, 1 is not; the agent insists on 1 and gets through once in ten times."""
    task = one_state(failure=[0.0, 1.0], mentor=[0.98, 0.02], takeover=[1.0, 0.9])
    assert task.rates == pytest.approx((0.02, 0.1, 0.1, 0.9))
    # fails with 0.1 + 0.9 * 0.02 = 0.118 in each step, ten steps: 10 * (epsilon + kappa - their
    # product), so that the direct bound is attained
    assert task.worst() == pytest.approx(1.18)
    # 10 * (0.02 + 0.1 + 9 * 0.02 * 0.1), and 10 * (0.02 + 0.1 + 9 * 0.0004 * 0.1)
    assert failure_bound(*task.rates) == pytest.approx(1.38)
    assert failure_bound(*task.rates, literal=True) == pytest.approx(1.2036)


@pytest.mark.parametrize(
    ("mentor", "takeover", "value"),
    [
        ([0.98, 0.02], [1.0, 1.0], 0.2),  # kappa = 0: the mentor alone, 0.02 a step
        ([1.0, 0.0], [0.0, 0.9], 1.0),  # epsilon = 0: an unsafe action slips through, 0.1 a step
        ([1.0, 0.0], [0.0, 1.0], 0.0),  # neither: nothing ever fails
    ],
)
def test_the_bound_is_attained(mentor: list[float], takeover: list[float], value: float) -> None:
    task = one_state([0.0, 1.0], mentor, takeover)
    assert task.worst() == pytest.approx(value)
    assert failure_bound(*task.rates) == pytest.approx(value)
    assert failure_bound(*task.rates, literal=True) == pytest.approx(value)


def test_only_epsilon_bounds_the_advantage() -> None:
    """The last step of the proof: with epsilon its inequality is tight, with epsilon² false.

    Action 0 leads from state 0 to state 2, where nothing fails, and so does the mentor. Action 1,
    the only one tolerated, leads to state 1, where the mentor fails with 0.1 in each step.
    """
    transitions = np.zeros((3, 2, 3))
    transitions[0, [0, 1], [2, 1]] = 1.0
    transitions[1, :, 1] = transitions[2, :, 2] = 1.0
    failure = np.array([[0.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    mentor = np.array([[1.0, 0.0], [0.9, 0.1], [1.0, 0.0]])
    takeover = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 1.0]])
    task = Task(transitions, failure, mentor, takeover, 0.9)
    assert task.rates == pytest.approx((0.1, 0.0, 1.0, 0.9))
    mentor_value = task.value(mentor)
    assert mentor_value == pytest.approx([0.0, 1.0, 0.0])
    advantage = failure[0, 1] + 0.9 * mentor_value[1] - mentor_value[0]
    assert advantage == pytest.approx(0.9)

    def allowed(literal: bool) -> float:
        whole = failure_bound(*task.rates, literal=literal)
        return 0.1 * (whole - failure_bound(0.1, 0.0, 0.0, 0.9))

    assert allowed(literal=False) == pytest.approx(0.9)
    assert allowed(literal=True) == pytest.approx(0.09)
    # the theorem itself is safe in either form: 0.9 * 1 against 10 and 1.9
    assert task.worst() == pytest.approx(1.0)
    assert task.value(task.mixed(np.eye(2)[[1, 0, 0]]))[0] == pytest.approx(0.9)
    assert failure_bound(*task.rates) == pytest.approx(10.0)
    assert failure_bound(*task.rates, literal=True) == pytest.approx(1.9)


def test_a_density_above_one_breaks_both_forms() -> None:
    """Actions in [0, 1] in ten cells; [0, 0.1] is unsafe and tolerated, the agent stays in it."""
    task = one_state([1.0] + [0.0] * 9, [0.0] + [1 / 9] * 9, [0.0] + [1.0] * 9)
    width = 0.1
    kappa, tolerance = (task.rates[index] * width for index in (1, 2))
    assert (kappa, tolerance) == pytest.approx((0.1, 0.1))
    assert task.worst() == pytest.approx(10.0)  # it fails in each step
    assert failure_bound(0.0, kappa, tolerance, 0.9) == pytest.approx(1.0)
    assert failure_bound(0.0, kappa, tolerance, 0.9, literal=True) == pytest.approx(1.0)
    density = 1 / width
    assert failure_bound(0.0, density * kappa, density * tolerance, 0.9) == pytest.approx(10.0)


@given(ARGUMENTS, ARGUMENTS, st.booleans())
def test_monotone_in_each_argument(
    first: tuple[float, ...], second: tuple[float, ...], literal: bool
) -> None:
    for index, (low, high) in enumerate(map(sorted, zip(first, second))):
        below, above = ([*first[:index], x, *first[index + 1 :]] for x in (low, high))
        smaller = failure_bound(*below, literal=literal)
        assert 0.0 <= smaller <= failure_bound(*above, literal=literal) * (1 + 1e-12)


@given(ARGUMENTS)
def test_the_printed_form_is_the_smaller_one(arguments: tuple[float, ...]) -> None:
    assert failure_bound(*arguments, literal=True) <= failure_bound(*arguments) * (1 + 1e-12)


def test_tensors_are_batched() -> None:
    epsilon = torch.tensor([[0.0], [0.02]], dtype=torch.float64, requires_grad=True)
    tolerance = torch.tensor([0.0, 0.1, 2.0], dtype=torch.float64)
    bound = failure_bound(epsilon, 0.1, tolerance, 0.9)
    assert bound.shape == (2, 3) and bound.dtype == torch.float64
    for row, column in itertools.product(range(2), range(3)):
        number = failure_bound(epsilon[row, 0].item(), 0.1, tolerance[column].item(), 0.9)
        assert isinstance(number, float)
        assert bound[row, column].item() == pytest.approx(number)
    bound[1, 1].backward()
    # d/d epsilon of 10 * (epsilon + 0.1 + 9 * epsilon * 0.1)
    assert epsilon.grad.flatten().tolist() == pytest.approx([0.0, 19.0])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((1.1, 0.0, 0.0, 0.9), "epsilon is 1.1"),
        ((-0.1, 0.0, 0.0, 0.9), "epsilon is -0.1"),
        ((torch.tensor([0.5, 2.0]), 0.0, 0.0, 0.9), "epsilon is 2.0"),
        ((0.0, 1.5, 0.0, 0.9), "kappa is 1.5"),
        ((0.0, math.nan, 0.0, 0.9), "kappa is nan"),
        ((0.0, 0.0, -1, 0.9), "tolerance is -1"),
        ((0.0, 0.0, math.inf, 0.9), "tolerance is inf"),
        ((0.0, 0.0, 0.0, 1.0), "gamma is 1.0"),
        ((0.0, 0.0, 0.0, -0.5), "gamma is -0.5"),
        ((torch.zeros(2), torch.zeros(3), 0.0, 0.9), r"shapes \(2,\), \(3,\) do not broadcast"),
    ],
)
def test_bad_values(arguments: tuple, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        failure_bound(*arguments)


def test_neither_number_nor_tensor() -> None:
    with pytest.raises(TypeError, match="kappa is a str: give a number or a tensor"):
        failure_bound(0.0, "0.1", 0.0, 0.9)
    with pytest.raises(TypeError, match="gamma is a list"):
        failure_bound(0.0, 0.1, 0.0, [0.9])


def test_a_discount_next_to_one_is_accepted() -> None:
    assert failure_bound(1e-9, 0.0, 0.0, 1.0 - 1e-9) == pytest.approx(1.0)
