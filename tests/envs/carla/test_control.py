"""From actions to CARLA's controls, with values by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from haim_torchrl.envs.carla.control import MAX_SPEED, STEERING, car_model, control_of

pytest.importorskip("carla")
LOCK = math.radians(70.0)
units = st.floats(-3.0, 3.0)


@pytest.mark.parametrize(
    ("action", "throttle", "brake", "steer"),
    [
        ((0.0, 0.0), 0.0, 0.0, 0.0),
        ((0.5, 0.0), 0.5, 0.0, 0.0),
        ((-0.25, 0.0), 0.0, 0.25, 0.0),
        ((0.0, 1.0), 0.0, 0.0, 0.5 / 1.2217305),  # 0.5 rad of 70 degrees, to the right
        ((0.0, -1.0), 0.0, 0.0, -0.5 / 1.2217305),
        ((7.0, -9.0), 1.0, 0.0, -0.5 / 1.2217305),
    ],
)
def test_values_by_hand(action, throttle, brake, steer):
    control = control_of(np.array(action), 5.0, LOCK)
    assert (control.throttle, control.brake) == pytest.approx((throttle, brake))
    assert control.steer == pytest.approx(steer)
    assert not (control.reverse or control.hand_brake or control.manual_gear_shift)


def test_no_throttle_at_the_speed_limit():
    assert control_of(np.array([1.0, 0.0]), MAX_SPEED - 0.1, LOCK).throttle == 1.0
    assert control_of(np.array([1.0, 0.0]), MAX_SPEED, LOCK).throttle == 0.0
    assert control_of(np.array([-1.0, 0.0]), MAX_SPEED, LOCK).brake == 1.0


@given(units, units, st.floats(0.0, 20.0), st.floats(0.2, 1.3))
def test_never_both_pedals_and_always_in_range(pedal, wheel, speed, lock):
    control = control_of(np.array([pedal, wheel]), speed, lock)
    assert control.throttle == 0.0 or control.brake == 0.0
    assert 0.0 <= control.throttle <= 1.0
    assert 0.0 <= control.brake <= 1.0
    assert -1.0 <= control.steer <= 1.0
    assert control.steer * wheel >= 0.0


@pytest.mark.parametrize("action", [(math.nan, 0.0), (0.0, math.inf)])
def test_no_number_is_refused(action):
    with pytest.raises(ValueError, match="two finite numbers"):
        control_of(np.array(action), 5.0, LOCK)


def test_the_model_of_the_car():
    model = car_model(4.8, 1.9)
    assert (model.length, model.width) == (4.8, 1.9)
    assert model.command(-1.0, 1.0) == (-8.0, STEERING)
    assert model.command(1.0, -1.0) == (4.0, -STEERING)
