import copy

import numpy as np
import pytest
import torch

from haim_torchrl.mentors import FallibleMentor, FunctionMentor
from haim_torchrl.switches import Always, Lapse, Never, Switch


def test_is_a_switch(scripted):
    assert isinstance(Lapse(scripted([True])), Switch)


def test_nothing_escapes_full_attention(run, scripted):
    answers = [False, True, False, True, True]
    assert run(Lapse(scripted(answers), rate=0.0), 5) == answers


def test_everything_escapes_none(run):
    assert run(Lapse(Always(), rate=1.0, steps=1), 6) == [False] * 6


def test_a_lapse_lasts_as_long_as_it_says(situation, scripted):
    switch = Lapse(scripted([False, True, True, False, True]), rate=1.0, steps=3)
    noticed = [switch(situation()[0]), switch(situation()[0])]  # the first firing meets a lapse
    switch.rate = 0.0
    noticed += [switch(situation()[0]) for _ in range(3)]
    assert noticed == [False, False, False, False, True]


def test_who_is_in_control_does_not_lapse(situation):
    switch = Lapse(Always(), rate=1.0)
    assert all(switch(situation(was_intervening=True)[0]) for _ in range(20))


def test_a_reset_ends_a_lapse(situation):
    switch = Lapse(Always(), rate=1.0, steps=100)
    assert not switch(situation()[0])
    switch.reset()
    switch.rate = 0.0
    assert switch(situation()[0])


def test_lapses_are_as_frequent_as_their_rate(situation):
    switch = Lapse(Always(), rate=0.2, steps=1)
    seen = [switch(situation()[0]) for _ in range(4000)]
    assert 1.0 - sum(seen) / 4000 == pytest.approx(0.2, abs=0.02)  # three deviations


def test_impossible_values_are_refused():
    with pytest.raises(ValueError, match=r"rate is 1\.5"):
        Lapse(Never(), rate=1.5)
    with pytest.raises(ValueError, match="steps is 0"):
        Lapse(Never(), steps=0)
    with pytest.raises(ValueError, match="seed is -1"):
        Lapse(Never(), seed=-1)


class Simulator:
    """Has a generator that resets draw from, as gymnasium's environments do."""

    def __init__(self, seed):
        self.np_random = np.random.default_rng(seed)


def noticed(switch, simulator, situation, episodes=3, steps=20):
    """What is noticed in some episodes, before each of which the simulator draws something."""
    seen = []
    for _ in range(episodes):
        if simulator is not None:
            simulator.np_random.random()
        switch.reset()
        seen.append(tuple(switch(situation(simulator=simulator)[0]) for _ in range(steps)))
    return seen


def test_the_seed_alone_decides_the_draws(situation):
    first, second, other = (
        noticed(Lapse(Always(), 0.5, 1, seed=seed), None, situation) for seed in (1, 1, 2)
    )
    assert first == second != other
    assert len(set(first)) == 3  # no episode repeats another


def test_nobody_elses_draws_are_used_up(situation):
    simulator, twin = Simulator(0), Simulator(0)
    torch.manual_seed(0)
    before = torch.get_rng_state()
    noticed(Lapse(Always(), 0.5, 1), simulator, situation, episodes=1)
    twin.np_random.random()
    assert torch.equal(torch.get_rng_state(), before)
    assert simulator.np_random.random() == twin.np_random.random()


def test_a_resumed_run_lapses_as_it_would_have(situation):
    simulator = Simulator(0)
    switch = Lapse(Always(), 0.5, 1)
    noticed(switch, simulator, situation)
    saved = copy.deepcopy(simulator)
    expected = noticed(switch, simulator, situation)
    assert noticed(Lapse(Always(), 0.5, 1), saved, situation) == expected


def test_workers_lapse_at_different_times(situation):
    first, second = (
        noticed(Lapse(Always(), 0.5, 1), Simulator(seed), situation) for seed in (0, 1)
    )
    assert first != second


def test_a_copy_goes_on_by_itself(situation):
    switch = Lapse(Always(), 0.5, 1)
    noticed(switch, None, situation, episodes=1)
    twin = copy.deepcopy(switch)
    assert noticed(twin, None, situation) == noticed(switch, None, situation)


def test_lapses_and_slips_of_one_seed_are_apart(situation):
    lapses = noticed(Lapse(Always(), 0.5, 1), None, situation, episodes=1, steps=200)[0]
    mentor = FallibleMentor(FunctionMentor(lambda *_: [0.0]), rate=0.5, steps=1, noise=0.0)
    slips = [bool(mentor.act(None, None).any()) for _ in range(200)]
    both = sum(slip and not seen for slip, seen in zip(slips, lapses))
    assert 25 <= both <= 75  # of 200; a quarter if they do not depend on each other
