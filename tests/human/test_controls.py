"""Controls and feel: values worked out by hand, and what holds for all of them."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.human import RELEASED, Controls, Feel
from haim_torchrl.human.controls import (
    at_rest,
    steering_lock,
    towards,
    wants_control,
    without_dead_zone,
)

FEEL = Feel()  # engage 0.15, opposite 0.5
axis = st.floats(-1.0, 1.0)
zones = st.floats(0.0, 0.99)
actions = st.tuples(axis, axis)
kinds = st.sampled_from(["keys", "gamepad", "wheel"])
steps = st.floats(1e-3, 1.0)


# Positions.
def test_the_brake_wins_over_the_throttle():
    assert Controls(steering=0.3, throttle=1.0).action == (1.0, 0.3)
    assert Controls(throttle=1.0, brake=0.25).action == (-0.25, 0.0)
    assert RELEASED.action == (0.0, 0.0)


@given(axis, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_an_action_stays_in_its_range(steering, throttle, brake):
    pedals, wheel = Controls(steering, throttle, brake).action
    assert -1.0 <= pedals <= 1.0 and wheel == steering
    assert pedals == -brake or brake == 0.0


# Dead zone.
@pytest.mark.parametrize(
    ("value", "zone", "seen"),
    [
        (0.0, 0.1, 0.0),
        (0.1, 0.1, 0.0),
        (-0.1, 0.1, 0.0),
        (0.55, 0.1, 0.5),  # 0.45 of 0.9
        (-0.28, 0.1, -0.2),
        (1.0, 0.1, 1.0),
        (-1.0, 0.1, -1.0),
        (0.7, 0.0, 0.7),
        (1.02, 0.05, 1.0),  # a sensor may exceed its range
    ],
)
def test_dead_zone_by_hand(value, zone, seen):
    assert without_dead_zone(value, zone) == pytest.approx(seen)


@given(zones)
def test_the_ends_of_an_axis_stay_where_they_are(zone):
    assert without_dead_zone(1.0, zone) == 1.0
    assert without_dead_zone(-1.0, zone) == -1.0
    assert without_dead_zone(zone, zone) == without_dead_zone(-zone, zone) == 0.0


@given(axis, zones)
def test_dead_zone_is_odd_and_has_no_negative_zero(value, zone):
    seen = without_dead_zone(value, zone)
    assert without_dead_zone(-value, zone) == -seen
    assert math.copysign(1.0, seen) == (-1.0 if seen < 0.0 else 1.0)
    assert abs(seen) <= abs(value) + 1e-12


@given(axis, axis, zones)
def test_dead_zone_is_monotone(one, other, zone):
    low, high = sorted((one, other))
    assert without_dead_zone(low, zone) <= without_dead_zone(high, zone)


def test_what_rests_is_no_input():
    feel = Feel(dead_zone=0.1)
    raw = Controls(steering=0.05, throttle=0.1, brake=0.55, takeover=True)
    expected = Controls(steering=0.0, throttle=0.0, brake=0.5, takeover=True)
    assert at_rest(raw, "wheel", feel) == at_rest(raw, "gamepad", feel) == expected
    assert at_rest(raw, "keys", feel) == raw


# Who drives.
@pytest.mark.parametrize("kind", ["keys", "gamepad", "wheel"])
def test_nothing_touched_wants_nothing(kind):
    for agent in ((0.0, 0.0), (1.0, 1.0), (-1.0, -1.0)):
        assert not wants_control(RELEASED, kind, agent, FEEL)


@pytest.mark.parametrize(
    ("kind", "controls", "agent", "wants"),
    [
        # The takeover key, pedals and drive keys.
        ("wheel", {"takeover": True}, 0.0, True),
        ("gamepad", {"takeover": True}, 0.0, True),
        ("keys", {"takeover": True}, 0.0, True),
        ("keys", {"throttle": 0.01}, 0.0, True),
        ("keys", {"brake": 1.0}, 0.0, True),
        ("keys", {"steering": -1.0}, -1.0, True),  # a key is never at rest somewhere
        ("wheel", {"throttle": 0.15}, 0.0, False),
        ("wheel", {"throttle": 0.16}, 0.0, True),
        ("gamepad", {"brake": 0.15}, 0.0, False),
        ("gamepad", {"brake": 0.16}, 0.0, True),
        # Sticks spring back: any way they are moved counts.
        ("gamepad", {"steering": 0.15}, 0.0, False),
        ("gamepad", {"steering": 0.16}, 1.0, True),
        ("gamepad", {"steering": -0.16}, 0.0, True),
        # A wheel rests anywhere: only turning it against the agent counts.
        ("wheel", {"steering": 0.9}, 0.2, False),  # the agent steers the same way, if less
        ("wheel", {"steering": 0.9}, 1.0, False),
        ("wheel", {"steering": 0.4}, -0.1, False),  # 0.5 away, which is not more than 0.5
        ("wheel", {"steering": 0.4}, -0.2, True),
        ("wheel", {"steering": -0.4}, 0.2, True),
        ("wheel", {"steering": 0.15}, -1.0, False),  # hardly turned, whatever the agent does
        ("wheel", {"steering": 0.51}, 0.0, True),
        ("wheel", {"steering": 0.0}, 1.0, False),
    ],
)
def test_what_means_i_drive(kind, controls, agent, wants):
    assert wants_control(Controls(**controls), kind, (0.0, agent), FEEL) is wants


@given(kinds, st.floats(0.0, 1.0), st.floats(0.0, 1.0), axis, actions)
def test_the_agents_pedals_never_matter_and_more_pedal_never_ends_a_wish(
    kind, throttle, brake, steering, agent
):
    one = Controls(steering, throttle, brake)
    wants = wants_control(one, kind, agent, FEEL)
    assert wants == wants_control(one, kind, (-agent[0], agent[1]), FEEL)
    if wants:
        harder = Controls(steering, min(2.0 * throttle, 1.0), min(2.0 * brake, 1.0))
        assert wants_control(harder, kind, agent, FEEL)


@given(kinds, axis, actions)
def test_left_is_as_good_as_right(kind, steering, agent):
    left = wants_control(Controls(steering), kind, agent, FEEL)
    right = wants_control(Controls(-steering), kind, (agent[0], -agent[1]), FEEL)
    assert left == right


# How far keys steer.
def test_steering_lock_by_hand():
    assert steering_lock("keys", 0.0, FEEL) == steering_lock("keys", 6.5, FEEL) == 1.0
    assert steering_lock("keys", 13.0, FEEL) == 0.25
    assert steering_lock("wheel", 13.0, FEEL) == steering_lock("gamepad", 30.0, FEEL) == 1.0


@given(st.floats(0.1, 40.0), st.floats(0.0, 60.0))
def test_keys_keep_the_lateral_acceleration(fastest, speed):
    lock = steering_lock("keys", speed, Feel(key_lock_speed=fastest))
    assert 0.0 < lock <= 1.0
    if speed <= fastest:
        assert lock == 1.0
    else:  # v² · lock, which the lateral acceleration is proportional to
        assert speed**2 * lock == pytest.approx(fastest**2)


# How fast a command moves.
def test_towards_by_hand():
    # In 0.1 s: pedals 1.0, keys 0.25, sticks and wheels 0.5.
    assert towards((0.0, 0.0), (1.0, 1.0), "keys", FEEL, 0.1) == (1.0, 0.25)
    assert towards((0.0, 0.0), (1.0, -1.0), "wheel", FEEL, 0.1) == (1.0, -0.5)
    assert towards((1.0, 0.9), (-1.0, 1.0), "gamepad", FEEL, 0.1) == (0.0, 1.0)
    assert towards((0.5, 0.5), (0.5, 0.5), "keys", FEEL, 0.1) == (0.5, 0.5)


@given(actions, actions, kinds, steps)
def test_a_command_never_overshoots_and_never_outruns_the_hand(command, wish, kind, dt):
    after = towards(command, wish, kind, FEEL, dt)
    steering = FEEL.key_steering_rate if kind == "keys" else FEEL.steering_rate
    for old, new, goal, rate in zip(command, after, wish, (FEEL.pedal_rate, steering)):
        assert min(old, goal) <= new <= max(old, goal)
        assert abs(new - old) <= rate * dt + 1e-12
        assert new == goal or abs(new - old) == pytest.approx(rate * dt)


@given(actions, actions, kinds)
def test_a_command_arrives(command, wish, kind):
    # The farthest way is 2, and keys go 0.25 in a step.
    for _ in range(8):
        command = towards(command, wish, kind, FEEL, 0.1)
    assert command == pytest.approx(wish, abs=1e-9)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"dead_zone": 1.0}, r"dead_zone is 1\.0"),
        ({"dead_zone": -0.1}, r"dead_zone is -0\.1"),
        ({"dead_zone": math.nan}, "dead_zone is nan"),
        ({"engage": 0.0}, r"engage is 0\.0"),
        ({"opposite": -1.0}, r"opposite is -1\.0"),
        ({"steering_rate": 0.0}, r"steering_rate is 0\.0"),
        ({"pedal_rate": math.nan}, "pedal_rate is nan"),
        ({"key_steering_rate": 0.0}, "key_steering_rate is 0"),
        ({"key_lock_speed": 0.0}, "key_lock_speed is 0"),
        ({"hand_back_steps": -1}, "hand_back_steps is -1"),
    ],
)
def test_a_feel_that_cannot_be_is_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        Feel(**settings)
