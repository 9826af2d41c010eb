"""A person as a mentor: nothing jumps, a device that fails is noticed, and somebody still drives.

The console is played; everything behind it is real.
"""

from __future__ import annotations

import math
import time

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from haim_torchrl.envs import make_env
from haim_torchrl.human import Brake, Controls, Feel, HumanMentor, Pause, Reading
from haim_torchrl.mentors import DeviceMentor, Mentor, RequestingMentor
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import AnyOf, RequestSwitch, RiskSwitch
from haim_torchrl.transforms import InterventionTransform

DT, FEEL = 0.1, Feel()
LOST = Reading(connected=False, trouble="plug the wheel in to go on")
axis = st.floats(-1.0, 1.0)
hands = st.builds(
    Controls,
    steering=axis,
    throttle=st.floats(0.0, 1.0),
    brake=st.just(0.0),
    takeover=st.booleans(),
) | st.just(Controls())


def step(mentor, agent=(0.0, 0.0), speed=0.0):
    """One step as the switch and the transform take it: who drives, and with what."""
    if not mentor.requests_control(None, torch.tensor(agent, dtype=torch.float64)):
        return False, agent
    action = mentor.act(None, TensorDict(speed=torch.tensor([speed])))
    return True, tuple(action.tolist())


def start(console, *arguments, **settings_):
    mentor = HumanMentor(console, *arguments, **settings_)
    mentor.reset(None)
    return mentor


def test_a_person_is_a_mentor_with_wishes_and_a_device(console):
    mentor = HumanMentor(console)
    assert isinstance(mentor, Mentor)
    assert isinstance(mentor, RequestingMentor)
    assert isinstance(mentor, DeviceMentor)
    assert isinstance(mentor.fallback, Pause)
    assert console.opened == 0  # in the process of the simulator, at the first reset
    mentor.reset(None)
    assert console.opened == 1


# Control passes without a jump.
def test_keys_take_over_and_hand_back_by_hand(console):
    mentor = start(console)
    agent = (0.4, 0.0)
    assert step(mentor, agent) == (False, agent)
    console.hands(steering=1.0, throttle=1.0)
    driven = [step(mentor, agent) for _ in range(5)]
    # Pedals move by up to 1 a step, and steering keys by 0.25, from where the agent was.
    assert driven == [(True, (1.0, steering)) for steering in (0.25, 0.5, 0.75, 1.0, 1.0)]
    console.hands()
    driven = [step(mentor, agent) for _ in range(5)]
    assert [who for who, _ in driven] == [True, True, True, False, False]
    for (_, action), steering in zip(driven, (0.75, 0.5, 0.25, 0.0, 0.0)):
        assert action == pytest.approx((0.4, steering))


def test_the_way_back_takes_at_most_so_many_steps(console):
    mentor = start(console, feel=Feel(hand_back_steps=2))
    console.hands(steering=1.0)
    for _ in range(4):
        step(mentor, (0.0, -1.0))
    console.hands()
    driven = [step(mentor, (0.0, -1.0)) for _ in range(4)]
    assert driven == [
        (True, (0.0, 0.75)),
        (True, (0.0, 0.5)),
        (False, (0.0, -1.0)),
        (False, (0.0, -1.0)),
    ]


def test_without_steps_the_agent_drives_at_once(console):
    mentor = start(console, feel=Feel(hand_back_steps=0))
    console.hands(steering=1.0)
    step(mentor)
    console.hands()
    assert step(mentor) == (False, (0.0, 0.0))


def test_who_takes_over_again_on_the_way_back_goes_on_from_there(console):
    mentor = start(console)
    console.hands(steering=1.0)
    for _ in range(4):
        step(mentor)
    console.hands()
    assert step(mentor) == (True, (0.0, 0.75))
    console.hands(steering=1.0)
    assert step(mentor) == (True, (0.0, 1.0))
    console.hands()  # and has all the steps of the way back again
    assert [step(mentor)[0] for _ in range(4)] == [True, True, True, False]


@given(
    kind=st.sampled_from(["keys", "gamepad", "wheel"]),
    drives=st.lists(st.tuples(st.tuples(axis, axis), hands), min_size=2, max_size=12),
)
@settings(max_examples=60, deadline=None)
def test_no_step_of_the_person_jumps(console_class, kind, drives):
    """From the action executed before, whoever that was, to the person's: within the rates."""
    console = console_class()
    mentor = start(console)
    steering = FEEL.key_steering_rate if kind == "keys" else FEEL.steering_rate
    before = (0.0, 0.0)
    for agent, controls in drives:
        console.reading = Reading(controls, kind, connected=True)
        driven, action = step(mentor, agent)
        if driven:
            for old, new, rate in zip(before, action, (FEEL.pedal_rate, steering)):
                assert abs(new - old) <= rate * DT + 1e-6
                assert -1.0 <= new <= 1.0
        else:
            assert action == agent
        before = action


@given(
    kind=st.sampled_from(["keys", "gamepad", "wheel"]),
    agent=st.tuples(axis, axis),
    controls=hands,
    held=st.integers(1, 10),
)
@settings(max_examples=60, deadline=None)
def test_control_comes_back_to_an_agent_that_holds_still(
    console_class, kind, agent, controls, held
):
    console = console_class()
    mentor = start(console)
    step(mentor, agent)
    console.reading = Reading(controls, kind, connected=True)
    before = agent
    for _ in range(held):
        before = step(mentor, agent)[1]
    console.hands(kind)
    rate = FEEL.key_steering_rate if kind == "keys" else FEEL.steering_rate
    far = abs(before[1] - agent[1]) > (FEEL.hand_back_steps + 1) * rate * DT
    for _ in range(FEEL.hand_back_steps + 1):
        driven, action = step(mentor, agent)
        if not far:
            assert abs(action[0] - before[0]) <= FEEL.pedal_rate * DT + 1e-6
            assert abs(action[1] - before[1]) <= rate * DT + 1e-6
        before = action
        if not driven:
            break
    assert not driven and action == agent


def test_keys_steer_less_at_speed_and_a_wheel_does_not(console):
    mentor = start(console)
    console.hands(steering=1.0)
    actions = [step(mentor, speed=13.0)[1][1] for _ in range(3)]
    assert actions == [0.25, 0.25, 0.25]  # (6.5 / 13)²
    assert step(mentor, speed=6.5)[1][1] == 0.5
    console.hands("wheel", steering=1.0, takeover=True)
    assert step(mentor, speed=13.0)[1][1] == 1.0


def test_a_new_episode_is_the_agents(console):
    mentor = start(console)
    console.hands(steering=1.0)
    step(mentor)
    mentor.reset(None)
    console.hands()
    assert step(mentor, (0.2, 0.3)) == (False, (0.2, 0.3))


def test_the_delay_of_the_input_is_passed_on(console):
    mentor = start(console)
    assert mentor.latency_ms is None
    console.reading = Reading(connected=True, latency_ms=12.5)
    step(mentor)
    assert mentor.latency_ms == 12.5


# The watchdog.
@pytest.mark.parametrize(
    ("driving", "age", "connected", "ok"),
    [
        (True, 0.3, True, True),
        (True, 0.31, True, False),
        (False, 0.31, True, True),
        (False, 2.0, True, True),
        (False, 2.01, True, False),
        (True, 0.0, False, False),
        (False, 0.0, False, False),
    ],
)
def test_how_long_a_device_may_be_silent(console, driving, age, connected, ok):
    mentor = start(console, stale_after=0.3, absent_after=2.0)
    console.hands(throttle=float(driving))
    assert step(mentor)[0] is driving
    console.reading = Reading(console.reading.controls, connected=connected, age=age)
    mentor.look()
    assert mentor.device_ok is ok


def test_a_dead_device_cannot_ask_for_control(console):
    mentor = start(console)
    console.reading = Reading(Controls(throttle=1.0), connected=False)
    assert step(mentor, (0.1, 0.0)) == (False, (0.1, 0.0))
    assert not mentor.device_ok


# What happens then.
def test_pause_says_what_is_awaited(console):
    mentor = start(console, Pause(), settle=0.08)
    console.reading = LOST
    assert mentor.hold() == "plug the wheel in to go on"
    console.reading = Reading(connected=False)
    assert mentor.hold() == "waiting for a driver"
    console.hands()
    assert mentor.hold() is None and mentor.device_ok  # who comes first need not settle
    console.reading = LOST
    assert mentor.hold() == "plug the wheel in to go on" and not mentor.device_ok
    console.reading = Reading(connected=True, age=9.0)
    assert mentor.hold() == "connection lost: waiting for the driver" and not mentor.device_ok


def test_who_is_back_settles_first(console):
    mentor = start(console, settle=0.08)
    console.hands()
    assert mentor.hold() is None
    console.reading = LOST
    mentor.hold()
    console.hands()
    began = time.monotonic()
    while (notice := mentor.hold()) is not None:
        assert notice == "the driver is back" and mentor.device_ok
        time.sleep(0.005)
    assert time.monotonic() - began >= 0.08
    # Lost again while settling: from the start.
    console.reading = LOST
    mentor.hold()
    console.hands()
    mentor.hold()
    console.reading = LOST
    assert mentor.hold() == LOST.trouble
    time.sleep(0.1)
    console.hands()
    assert mentor.hold() == "the driver is back"


def test_no_time_to_settle(console):
    mentor = start(console, settle=0.0)
    for console.reading in (Reading(connected=True), LOST, Reading(connected=True)):
        notice = mentor.hold()
    assert notice is None


def test_a_pause_is_said_first(console):
    mentor = start(console)
    console.reading = Reading(connected=False, paused=True)
    assert mentor.hold() == "paused"
    console.reading = Reading(connected=True, paused=True, quit=True)
    assert mentor.hold() == "paused" and mentor.reading.quit
    console.hands()
    assert mentor.hold() is None and not mentor.reading.quit


@pytest.mark.parametrize("driving", [True, False])
def test_brake_drives_within_one_step_and_holds_nothing(console, driving):
    mentor = start(console, Brake())
    console.hands(throttle=float(driving))
    assert step(mentor)[0] is driving and not mentor.falling_back
    console.reading = LOST
    assert mentor.hold() is None
    assert step(mentor, (1.0, 1.0)) == (True, (pytest.approx(-0.6), 0.0))
    assert mentor.falling_back and not mentor.device_ok
    assert step(mentor, (1.0, 1.0))[0]
    # Back, and touching nothing: from the brake to the agent without a jump.
    console.hands()
    assert mentor.hold() is None  # what moves need not settle
    assert step(mentor, (1.0, 0.0)) == (True, (pytest.approx(0.4), 0.0))
    assert not mentor.falling_back
    assert step(mentor, (1.0, 0.0)) == (False, (1.0, 0.0))


def test_nothing_moves_before_a_person_has_come_whatever_the_fallback(console):
    mentor = start(console, Brake())
    console.reading = Reading(connected=False)
    assert mentor.hold() == "waiting for a driver"


@pytest.mark.parametrize("braking", [0.0, 0.5, -1.5, math.nan])
def test_a_brake_that_does_not_brake_is_refused(braking):
    with pytest.raises(ValueError, match=f"braking is {braking}"):
        Brake(braking)


@pytest.mark.parametrize(
    ("settings_", "error", "message"),
    [
        ({"stale_after": 0.0}, ValueError, r"stale_after is 0\.0: it must be positive, in sec"),
        ({"absent_after": -1.0}, ValueError, r"absent_after is -1\.0"),
        ({"time_step": math.nan}, ValueError, "time_step is nan"),
        ({"fallback": "brake"}, TypeError, "fallback is str: give a mentor, such as"),
        ({"console": None}, TypeError, "console is NoneType, which is no console"),
        ({"console": object()}, TypeError, "console is object"),
    ],
)
def test_what_cannot_work_is_refused(console, settings_, error, message):
    with pytest.raises(error, match=message):
        HumanMentor(**{"console": console, **settings_})


# In the real world, with switches.
def world(mentor, switch):
    takeover = InterventionTransform(lambda: mentor, switch)
    env = TransformedEnv(make_env(horizon=60, observation={"rays": 24}), takeover)
    env.set_seed(0)
    return env


def drive(env, action, steps, before_step=lambda k: None):
    """Steps with one proposal; what stands under next, one row a step."""
    rows, state = [], env.reset()
    for k in range(steps):
        before_step(k)
        after = env.step(state.set("action", torch.tensor(action)))
        rows.append(after["next"].clone())
        state = env.step_mdp(after)
    return torch.stack(rows)


def test_an_expert_drives_in_the_place_of_a_person_who_is_gone(console):
    env = world(HumanMentor(console, ExpertMentor()), RequestSwitch())

    def lose(k):
        console.reading = LOST if 5 <= k < 15 else Reading(connected=True)

    rows = drive(env, (0.0, 0.0), 25, lose)
    driven = rows["intervention"].squeeze(-1)
    assert driven[5:15].all() and not driven[:5].any()
    assert rows["takeover_start"].squeeze(-1).nonzero().squeeze(-1).tolist() == [5]
    assert driven[15:].sum() <= FEEL.hand_back_steps and not driven[-1]
    # It is the expert who drives: it sets off from a standstill.
    assert (rows["action_mentor"][5:15, 0] > 0.0).all()
    env.close()


@pytest.mark.parametrize("person_first", [True, False])
def test_beside_a_shield_the_person_may_act_without_having_asked(console, person_first):
    switches = [RequestSwitch(), RiskSwitch()]
    env = world(HumanMentor(console), AnyOf(*(switches if person_first else switches[::-1])))

    def press(k):
        console.hands(throttle=1.0 if 3 <= k < 6 else 0.0)

    rows = drive(env, (0.6, 0.5), 40, press)  # turns off the road, which the shield foresees
    driven = rows["intervention"].squeeze(-1)
    assert driven[3:6].all() and (rows["behavior_action"][4:6, 0] == 1.0).all()
    assert driven[10:].any()  # with nothing touched: the shield asked for it
    # Hands off the keys wish for nothing: a step of the keys nearer to zero than the agent.
    onset = 10 + int(driven[10:].nonzero()[0])
    assert rows["action_mentor"][onset].tolist() == pytest.approx([0.0, 0.25])
    env.close()


@pytest.mark.parametrize("person_first", [True, False])
def test_beside_a_shield_a_dead_device_never_drives(console, person_first):
    """Whichever switch asks, and from the first step on in which the device is dead."""
    switches = [RequestSwitch(), RiskSwitch()]
    switch = AnyOf(*(switches if person_first else switches[::-1]))
    env = world(HumanMentor(console, Brake(-0.6)), switch)
    action = (0.6, 0.5)  # turns off the road, which the shield foresees
    console.hands()
    driven = drive(env, action, 40)["intervention"].squeeze(-1)
    onset = int(driven.nonzero()[0])

    def lose(k):
        console.reading = LOST if k >= onset else Reading(connected=True)

    env.set_seed(0)  # the same episode
    rows = drive(env, action, onset + 3, lose)
    env.close()
    assert rows["intervention"].squeeze(-1).tolist() == [False] * onset + [True] * 3
    for executed in rows["behavior_action"][onset:].tolist():
        assert executed == pytest.approx([-0.6, 0.0])
