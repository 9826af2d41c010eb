"""Car-following models against values worked out by hand."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.traffic import IDMParameters, OVMParameters, idm_acceleration, ovm_acceleration
from haim_torchrl.traffic.car_following import MINIMUM_GAP

FLOAT64 = torch.float64


def tensor(*values):
    return torch.tensor(values, dtype=FLOAT64)


@pytest.mark.parametrize(
    ("speed", "gap", "lead_speed", "expected"),
    [
        # s* = 5 + 10*1 + 10*2/(2*4) = 17.5; (17.5/20)^2 = 0.765625; (10/15)^4 = 16/81
        (10.0, 20.0, 8.0, 4 * (1 - 16 / 81 - 0.765625)),
        # standing: s* = 5; 4 * (1 - (5/10)^2) = 3, however fast the leader is
        (0.0, 10.0, 0.0, 3.0),
        (0.0, 10.0, 15.0, 3.0),
        # standing at the standstill gap: in equilibrium (eq. 2)
        (0.0, 5.0, 0.0, 0.0),
        # leader draws away: 5*1 + 5*(-10)/8 = -1.25 -> 0, s* = 5; (5/10)^2 = 1/4; (5/15)^4 = 1/81
        (5.0, 10.0, 15.0, 4 * (1 - 1 / 81 - 1 / 4)),
        # free road at the desired speed
        (15.0, 1e9, 15.0, 0.0),
        # crawling up too close: s* = 5 + 2*1 + 2*2/8 = 7.5; (7.5/2.5)^2 = 9; (2/15)^4 = 16/50625
        (2.0, 2.5, 0.0, 4 * (1 - 16 / 50625 - 9)),
    ],
)
def test_idm_golden_values(speed, gap, lead_speed, expected):
    result = idm_acceleration(tensor(speed), tensor(gap), tensor(lead_speed))
    torch.testing.assert_close(result, tensor(expected), atol=1e-9, rtol=1e-9)


def test_idm_follows_its_parameters():
    params = IDMParameters(
        s0=2,
        time_headway=2,
        max_acceleration=1,
        comfortable_deceleration=4,
        desired_speed=20,
        exponent=2,
    )
    # s* = 2 + 10*2 + 10*2/(2*sqrt(4)) = 27; (27/30)^2 = 0.81; (10/20)^2 = 0.25
    result = idm_acceleration(tensor(10), tensor(30), tensor(8), params)
    torch.testing.assert_close(result, tensor(1 - 0.25 - 0.81))
    torch.testing.assert_close(params(tensor(10), tensor(30), tensor(8)), result)


@pytest.mark.parametrize(
    ("speed", "gap", "lead_speed", "expected"),
    [
        # half way between 5 and 35 m: V = 15/2; 0.6*(7.5 - 5) + 0.9*(6 - 5) = 2.4
        (5.0, 20.0, 6.0, 2.4),
        # at and beyond the ends V is 0 and 15
        (4.0, 5.0, 4.0, -0.6 * 4),
        (4.0, 0.0, 4.0, -0.6 * 4),
        (10.0, 50.0, 10.0, 0.6 * 5),
        # a quarter of the way: V = 7.5*(1 - cos(pi/4)) = 7.5*(1 - sqrt(1/2))
        (0.0, 12.5, 0.0, 0.6 * 7.5 * (1 - math.sqrt(0.5))),
    ],
)
def test_ovm_golden_values(speed, gap, lead_speed, expected):
    result = ovm_acceleration(tensor(speed), tensor(gap), tensor(lead_speed))
    torch.testing.assert_close(result, tensor(expected), atol=1e-9, rtol=1e-9)


def test_bandos_model_does_not_see_the_leaders_speed():
    bando = OVMParameters(relative_speed_gain=0)
    slow, fast = bando(tensor(5), tensor(20), tensor(0)), bando(tensor(5), tensor(20), tensor(15))
    torch.testing.assert_close(slow, fast)
    torch.testing.assert_close(slow, tensor(0.6 * 2.5))


@pytest.mark.parametrize("model", [idm_acceleration, ovm_acceleration])
def test_any_shapes_broadcast(model):
    speed, gap, lead_speed = torch.rand(3, 1, 5), torch.rand(4, 1) * 30, torch.rand(5)
    result = model(speed, gap, lead_speed)
    assert result.shape == (3, 4, 5)
    torch.testing.assert_close(result[2, 1, 3], model(speed[2, 0, 3], gap[1, 0], lead_speed[3]))
    assert model(10.0, 20.0, 8.0).shape == ()


@pytest.mark.parametrize("model", [idm_acceleration, ovm_acceleration])
def test_stays_on_the_device_and_type_of_its_inputs(model):
    speed = torch.empty(2, 5, device="meta", dtype=torch.float64)
    result = model(speed, speed, speed)
    assert result.device.type == "meta"
    assert result.dtype == torch.float64


@pytest.mark.parametrize("model", [idm_acceleration, ovm_acceleration])
def test_gradients_are_those_of_the_formula(model):
    inputs = [tensor(v).requires_grad_() for v in (7.0, 18.0, 6.0)]
    assert torch.autograd.gradcheck(model, inputs)


def test_idm_gradient_by_hand():
    # at v = 0 only the gap acts: d acc / d gap = 4 * 2 * 5^2 / gap^3 = 200 / 1000
    gap = tensor(10).requires_grad_()
    idm_acceleration(tensor(0), gap, tensor(0)).backward()
    torch.testing.assert_close(gap.grad, tensor(0.2))


@given(
    speed=st.floats(0, 60),
    gap=st.floats(-10, 1000),
    lead_speed=st.floats(0, 60),
    desired_speed=st.floats(0, 40),
)
@settings(deadline=None)
def test_idm_is_finite_with_finite_gradients_everywhere(speed, gap, lead_speed, desired_speed):
    inputs = [
        torch.tensor(v, dtype=torch.float32).requires_grad_() for v in (speed, gap, lead_speed)
    ]
    result = idm_acceleration(*inputs, IDMParameters(desired_speed=desired_speed))
    result.backward()
    assert torch.isfinite(result)
    assert all(torch.isfinite(value.grad) for value in inputs)
    assert result <= 4.0


@given(
    speed=st.floats(0, 15),
    gap=st.floats(0.5, 100),
    lead_speed=st.floats(0, 15),
    more=st.floats(0, 9),
)
@settings(deadline=None)
def test_idm_never_brakes_for_more_room_or_a_faster_leader(speed, gap, lead_speed, more):
    base = idm_acceleration(tensor(speed), tensor(gap), tensor(lead_speed))
    assert idm_acceleration(tensor(speed), tensor(gap + more), tensor(lead_speed)) >= base - 1e-9
    assert idm_acceleration(tensor(speed), tensor(gap), tensor(lead_speed + more)) >= base - 1e-9


def test_touching_bumpers_brake_as_at_the_smallest_gap():
    at_floor = idm_acceleration(tensor(5), tensor(MINIMUM_GAP), tensor(5))
    assert at_floor < -100
    for gap in (0.0, -3.0):
        torch.testing.assert_close(idm_acceleration(tensor(5), tensor(gap), tensor(5)), at_floor)


def test_a_driver_who_wants_to_stand_brakes():
    assert idm_acceleration(tensor(1), tensor(1000), tensor(1), IDMParameters(desired_speed=0)) < 0


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        (IDMParameters, "s0", -1),
        (IDMParameters, "time_headway", math.nan),
        (IDMParameters, "max_acceleration", 0),
        (IDMParameters, "comfortable_deceleration", -4),
        (IDMParameters, "desired_speed", math.inf),
        (IDMParameters, "exponent", 0.5),
        (OVMParameters, "speed_gain", 0),
        (OVMParameters, "go_gap", 5),
    ],
)
def test_unphysical_parameters_are_named(kind, field, value):
    with pytest.raises(ValueError, match=f"{kind.__name__}.{field}"):
        kind(**{field: value})


def test_parameters_that_are_no_numbers_are_named():
    with pytest.raises(TypeError, match=r"IDMParameters.s0 must be a number"):
        IDMParameters(s0="5")
