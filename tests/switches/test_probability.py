import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import ProbabilitySwitch, Situation

ACTION = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


class Likes:
    """A mentor with a density of its own."""

    def __init__(self, density):
        self.value = density

    def reset(self, simulator): ...

    def act(self, simulator, tensordict):
        return torch.zeros(2)

    def density(self, simulator, tensordict, action):
        return self.value


def test_kernel_by_hand(situation):
    switch = ProbabilitySwitch(eta=0.2, sigma=(0.5, 0.25))
    # deviations 0.25 and 0.25: exp(-1/2 (0.5^2 + 1^2)) = exp(-0.625)
    step, _ = situation(agent=(0.5, 0.0), mentor=(0.25, 0.25))
    assert switch.density(step) == pytest.approx(math.exp(-0.625), rel=1e-6)
    assert switch(step) is False
    # deviation 0.5 in steering alone: exp(-2) = 0.135 < 0.2
    assert switch(situation(agent=(0.25, 0.75), mentor=(0.25, 0.25))[0]) is True


def test_one_width_for_all(situation):
    step, _ = situation(agent=(0.3, 0.4), mentor=(0.0, 0.0))
    assert ProbabilitySwitch(sigma=0.5).density(step) == pytest.approx(math.exp(-0.5), rel=1e-6)


def test_threshold_itself_is_acceptable(situation):
    step, _ = situation()
    assert ProbabilitySwitch(eta=1.0)(step) is False  # the mentor's own action, density 1 >= eta


@given(ACTION, ACTION, st.floats(0.01, 1.0))
def test_density_is_relative_and_decides(agent, mentor, eta):
    switch = ProbabilitySwitch(eta=eta)
    step = Situation(
        None, None, torch.tensor(agent), FunctionMentor(lambda *_: list(mentor)), False
    )
    density = switch.density(step)
    assert 0.0 <= density <= 1.0
    assert switch(step) is (density < eta)


@pytest.mark.parametrize(("density", "takes_over"), [(0.19, True), (0.2, False)])
def test_asks_a_mentor_that_has_a_density(situation, density, takes_over):
    step, _ = situation(agent=(1.0, 1.0), who=Likes(density))
    assert ProbabilitySwitch(eta=0.2)(step) is takes_over


def test_kernel_can_be_insisted_on(situation):
    step, _ = situation(agent=(1.0, 1.0), who=Likes(1.0))
    assert ProbabilitySwitch(eta=0.2, kernel_only=True)(step) is True


@pytest.mark.parametrize("eta", [0.0, -0.1, 1.1, math.nan])
def test_bad_eta(eta):
    with pytest.raises(ValueError, match="eta is"):
        ProbabilitySwitch(eta=eta)


@pytest.mark.parametrize("sigma", [0.0, (0.1, 0.0), ()])
def test_bad_sigma(sigma):
    with pytest.raises(ValueError, match="must be positive"):
        ProbabilitySwitch(sigma=sigma)


def test_widths_must_fit_the_action(situation):
    with pytest.raises(ValueError, match="3 widths but the action has 2"):
        ProbabilitySwitch(sigma=(0.1, 0.1, 0.1))(situation()[0])
