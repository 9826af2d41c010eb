import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.switches import (
    AllOf,
    Always,
    AnyOf,
    Delay,
    Hold,
    Never,
    RequestSwitch,
    Situation,
    Switch,
)

ANSWERS = st.lists(st.booleans(), min_size=1, max_size=30)


class Script:
    memoryless = False

    def __init__(self, answers):
        self.answers, self.asked = answers, 0

    def reset(self):
        self.asked = 0

    def __call__(self, situation):
        self.asked += 1
        return self.answers[self.asked - 1]


def drive(switch, steps):
    driven, before = [], False
    for _ in range(steps):
        before = switch(Situation(None, None, None, None, before, lambda *_: None))
        driven.append(before)
    return driven


def test_constant_switches(run):
    assert run(Never(), 3) == [False] * 3
    assert run(Always(), 3) == [True] * 3


def test_all_are_switches(scripted):
    inner = scripted([True])
    for switch in (
        Never(),
        Always(),
        RequestSwitch(),
        AnyOf(inner),
        AllOf(inner),
        Hold(inner),
        Delay(inner),
    ):
        assert isinstance(switch, Switch)


def test_hold_keeps_control_from_the_last_firing_on(run, scripted):
    fires = [0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0]
    expect = [0, 1, 1, 1, 0, 0, 1, 1, 1, 1, 1, 0]
    assert run(Hold(scripted(fires), 3), len(fires)) == [bool(e) for e in expect]


def test_delay_waits_for_a_danger_that_lasts(run, scripted):
    fires = [1, 1, 0, 1, 1, 1, 1, 0, 1, 0]
    expect = [0, 0, 0, 0, 0, 1, 1, 0, 0, 0]
    assert run(Delay(scripted(fires), 2), len(fires)) == [bool(e) for e in expect]


def test_delay_does_not_hold_up_a_mentor_in_control(situation, scripted):
    switch = Delay(scripted([1, 1]), 5)
    assert switch(situation(was_intervening=True)[0])
    assert not Delay(scripted([0]), 5)(situation(was_intervening=True)[0])


def test_held_reaction(run, scripted):
    fires = [1, 1, 1, 0, 0, 0, 1, 0, 0, 0]
    expect = [0, 0, 1, 1, 1, 0, 0, 0, 0, 0]
    switch = Hold(Delay(scripted(fires), 2), 3)
    assert run(switch, len(fires)) == [bool(e) for e in expect]


@given(ANSWERS)
def test_trivial_hold_and_delay_are_the_switch_itself(answers):
    assert drive(Hold(Script(answers), 1), len(answers)) == answers
    assert drive(Delay(Script(answers), 0), len(answers)) == answers


@given(ANSWERS, st.integers(1, 6))
def test_hold_is_true_within_steps_of_a_firing_and_only_there(answers, steps):
    expect = [any(answers[max(0, t - steps + 1) : t + 1]) for t in range(len(answers))]
    assert drive(Hold(Script(answers), steps), len(answers)) == expect


@given(ANSWERS, st.integers(0, 6))
def test_delay_starts_only_after_a_run_of_firings(answers, steps):
    driven = drive(Delay(Script(answers), steps), len(answers))
    for t, now in enumerate(driven):
        assert not now or answers[t]
        if now and (t == 0 or not driven[t - 1]):
            assert t >= steps and all(answers[t - steps : t + 1])


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=20))
def test_combinations_are_or_and_and(pairs):
    first, second = zip(*pairs)
    either = drive(AnyOf(Script(first), Script(second)), len(pairs))
    both = drive(AllOf(Script(first), Script(second)), len(pairs))
    assert either == [a or b for a, b in pairs]
    assert both == [a and b for a, b in pairs]


def test_members_with_memory_see_every_step(run, scripted):
    counting = scripted([0, 0, 0])
    assert run(AnyOf(Always(), counting), 3) == [True] * 3
    assert counting.asked == 3
    idle = scripted([1, 1, 1], memoryless=True)
    run(AllOf(Never(), idle), 3)
    assert idle.asked == 0


def test_combination_of_memoryless_members_has_none(scripted):
    assert AnyOf(Always(), Never()).memoryless
    assert not AnyOf(Always(), Hold(Never())).memoryless


def test_reset_reaches_every_member_and_ends_a_hold(run, scripted):
    first, second = scripted([1, 0, 0]), scripted([0, 0, 0])
    switch = AnyOf(Hold(first, 3), Delay(second, 1))
    assert run(switch, 1) == [True]
    first.answers = [0, 0, 0]
    switch.reset()
    assert (first.resets, second.resets) == (1, 1)
    assert run(switch, 1) == [False]


def test_reset_ends_a_reaction(run, scripted):
    switch = Delay(scripted([1, 1, 1]), 1)
    assert run(switch, 1) == [False]
    switch.reset()
    assert run(switch, 2) == [False, True]


def test_request_switch_asks_the_mentor(situation):
    class Person:
        def reset(self, simulator): ...

        def act(self, simulator, tensordict): ...

        def requests_control(self, simulator, action_agent):
            return simulator == "alarm"

    assert RequestSwitch()(situation(simulator="alarm", who=Person())[0]) is True
    assert RequestSwitch()(situation(simulator="calm", who=Person())[0]) is False


def test_request_switch_needs_a_mentor_that_asks(situation):
    with pytest.raises(TypeError, match="requests_control"):
        RequestSwitch()(situation()[0])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Hold(Never(), 0), "steps is 0"),
        (lambda: Delay(Never(), -1), "cannot be negative"),
        (lambda: AnyOf(), "at least one"),
    ],
)
def test_bad_numbers(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_combinations_take_switches_only():
    with pytest.raises(TypeError, match="combines switches, got bool"):
        AllOf(Never(), True)
