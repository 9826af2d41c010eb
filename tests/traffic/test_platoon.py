"""Platoon prediction: steps by hand, and what must hold for any model and state."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.traffic import IDMParameters, OVMParameters, idm_acceleration, rollout_platoon

FLOAT64 = torch.float64


def tensor(*values):
    return torch.tensor(values, dtype=FLOAT64)


def reckless(speed, gap, lead_speed):
    """A driver who does not look ahead."""
    return torch.ones_like(speed) * 3.0


@st.composite
def platoons(draw, largest_gap=80.0):
    followers = draw(st.integers(1, 6))
    gaps = draw(st.lists(st.floats(0, largest_gap), min_size=followers, max_size=followers))
    speeds = draw(st.lists(st.floats(0, 15), min_size=followers, max_size=followers))
    lead_speed, lead_acceleration = draw(st.floats(0, 15)), draw(st.floats(-12, 4))
    return tensor(*gaps), tensor(*speeds), tensor(lead_speed), tensor(lead_acceleration)


def test_two_steps_by_hand():
    result = rollout_platoon(
        tensor(10, 20), tensor(0, 0), tensor(10), tensor(-5), duration=2, time_step=1
    )
    # step 1. AV: 10 -> 5, way 7.5.
    #   follower 0: s* = 5, acc = 4*(1 - (5/10)^2) = 3: speed 3, way 1.5, gap 10 + 7.5 - 1.5 = 16
    #   follower 1: acc = 4*(1 - (5/20)^2) = 3.75: speed 3.75, way 1.875, gap 20 + 1.5 - 1.875
    # step 2. AV: 5 -> 0, way 2.5.
    #   follower 0: s* = 5 + 3 + 3*(3 - 5)/8 = 7.25; acc = 4*(1 - (3/15)^4 - (7.25/16)^2)
    #   follower 1: s* = 5 + 3.75 + 3.75*(3.75 - 3)/8 = 9.1015625;
    #               acc = 4*(1 - (3.75/15)^4 - (9.1015625/19.625)^2)
    acc0 = 4 * (1 - 0.2**4 - (7.25 / 16) ** 2)
    acc1 = 4 * (1 - 0.25**4 - (9.1015625 / 19.625) ** 2)
    assert acc0 == pytest.approx(3.1723109375)
    way0, way1 = 3 + acc0 / 2, 3.75 + acc1 / 2
    close = {"atol": 1e-12, "rtol": 1e-12}
    torch.testing.assert_close(
        result.speeds, tensor(0, 0, 3, 3.75, 3 + acc0, 3.75 + acc1).view(3, 2), **close
    )
    torch.testing.assert_close(
        result.accelerations, tensor(3, 3.75, acc0, acc1).view(2, 2), **close
    )
    gaps = tensor(10, 20, 16, 19.625, 16 + 2.5 - way0, 19.625 + way0 - way1).view(3, 2)
    torch.testing.assert_close(result.gaps, gaps, **close)
    torch.testing.assert_close(result.lead_speed, tensor(10, 5, 0).view(3, 1), **close)
    torch.testing.assert_close(result.lead_position, tensor(0, 7.5, 10).view(3, 1), **close)
    # follower 0 started 10 m behind the AV, follower 1 another 20 m behind
    positions = tensor(-10, -30, -8.5, -28.125, -8.5 + way0, -28.125 + way1).view(3, 2)
    torch.testing.assert_close(result.positions, positions, **close)


def test_a_vehicle_that_stops_within_a_step_covers_only_its_braking_distance():
    # from 2 m/s at -8 m/s^2 the AV stands after 0.25 s and 2^2 / (2*8) = 0.25 m
    result = rollout_platoon(tensor(50), tensor(0), tensor(2), tensor(-8), duration=3, time_step=1)
    torch.testing.assert_close(result.lead_speed.flatten(), tensor(2, 0, 0, 0))
    torch.testing.assert_close(result.lead_position.flatten(), tensor(0, 0.25, 0.25, 0.25))


@pytest.mark.parametrize(
    ("hold", "speeds", "positions"),
    [
        (None, (12, 10, 8, 6), (0, 11, 20, 27)),
        (3, (12, 10, 8, 6), (0, 11, 20, 27)),
        (1, (12, 10, 10, 10), (0, 11, 21, 31)),
        (0, (12, 12, 12, 12), (0, 12, 24, 36)),
    ],
)
def test_the_av_holds_its_acceleration_for_the_given_time(hold, speeds, positions):
    result = rollout_platoon(
        tensor(50), tensor(12), tensor(12), tensor(-2), duration=3, time_step=1, hold=hold
    )
    torch.testing.assert_close(result.lead_speed.flatten(), tensor(*speeds))
    torch.testing.assert_close(result.lead_position.flatten(), tensor(*positions))


def test_speeds_end_at_the_limit():
    result = rollout_platoon(tensor(500), tensor(14), 14.0, 4.0, model=reckless, max_speed=15)
    assert result.lead_speed[-1] == 15
    assert result.speeds[-1] == 15
    free = rollout_platoon(tensor(500), tensor(14), 14.0, 4.0, model=reckless, max_speed=math.inf)
    torch.testing.assert_close(free.lead_speed[-1], tensor(14 + 40))
    torch.testing.assert_close(free.speeds[-1], tensor(14 + 30))


def test_a_platoon_in_equilibrium_stays_in_it():
    # eq. 2: F(d*, 0, v*) = 0, with d* = s*/sqrt(1 - (v/v0)^4) = 15/sqrt(1 - 16/81) at 10 m/s
    gap = 15 / math.sqrt(1 - 16 / 81)
    result = rollout_platoon(torch.full((5,), gap, dtype=FLOAT64), tensor(*[10] * 5), 10.0, 0.0)
    torch.testing.assert_close(result.speeds, torch.full_like(result.speeds, 10.0))
    torch.testing.assert_close(result.gaps, torch.full_like(result.gaps, gap))


def test_standing_traffic_stands():
    result = rollout_platoon(tensor(1, 4.9, 0), tensor(0, 0, 0), 0.0, -8.0)
    torch.testing.assert_close(result.gaps, tensor(1, 4.9, 0).expand(101, 3))
    assert not result.speeds.any()


@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3)])
def test_batches_are_predicted_one_by_one(batch):
    generator = torch.Generator().manual_seed(0)
    gaps = torch.rand(*batch, 4, generator=generator, dtype=FLOAT64) * 30
    speeds = torch.rand(*batch, 4, generator=generator, dtype=FLOAT64) * 15
    lead_speed = torch.rand(*batch, 1, generator=generator, dtype=FLOAT64) * 15
    pulse = torch.rand(*batch, 1, generator=generator, dtype=FLOAT64) * 12 - 8
    result = rollout_platoon(gaps, speeds, lead_speed, pulse, duration=2)
    assert result.speeds.shape == result.gaps.shape == result.positions.shape == (*batch, 21, 4)
    assert result.accelerations.shape == (*batch, 20, 4)
    assert result.lead_speed.shape == result.lead_position.shape == (*batch, 21, 1)
    last = (-1,) * len(batch)
    one = rollout_platoon(gaps[last], speeds[last], lead_speed[last], pulse[last], duration=2)
    for many, single in zip(result, one, strict=True):
        torch.testing.assert_close(many[last], single)


def test_state_and_actions_broadcast():
    gaps, speeds = torch.full((5,), 15.0), torch.full((5,), 10.0)
    pulses = torch.linspace(-8, 4, 7).unsqueeze(-1)
    result = rollout_platoon(gaps, speeds, 10.0, pulses, duration=1)
    assert result.speeds.shape == (7, 11, 5)
    assert (result.lead_speed[:, -1, 0].diff() > 0).all()


def test_stays_on_the_device_of_its_inputs():
    state = torch.empty(3, 5, device="meta")
    result = rollout_platoon(state, state, 10.0, -6.0, duration=0.5)
    assert {part.device.type for part in result} == {"meta"}


@pytest.mark.parametrize("model", [IDMParameters(), OVMParameters(), reckless])
@given(platoon=platoons())
@settings(deadline=None, max_examples=30)
def test_no_reversing_no_overlap_no_speeding(model, platoon):
    result = rollout_platoon(*platoon, model=model, duration=5)
    for speeds in (result.speeds, result.lead_speed):
        assert (speeds >= 0).all()
        assert (speeds <= 15).all()
    assert (result.gaps >= 0).all()
    assert (result.positions.diff(dim=-2) >= -1e-9).all()
    rear = torch.cat([result.lead_position, result.positions[..., :-1]], dim=-1)
    torch.testing.assert_close(rear - result.positions, result.gaps)


@given(platoon=platoons())
@settings(deadline=None, max_examples=30)
def test_a_standing_vehicle_keeps_or_gains_room(platoon):
    result = rollout_platoon(*platoon, duration=5)
    standing = (result.speeds[:-1] == 0) & (result.speeds[1:] == 0)
    assert (result.gaps.diff(dim=-2)[standing] >= -1e-9).all()


def test_a_driver_who_does_not_look_is_held_by_the_vehicle_in_front():
    result = rollout_platoon(tensor(5), tensor(15), 0.0, 0.0, model=reckless, duration=1)
    assert result.gaps[-1] == 0
    assert result.speeds[-1] == 0


def test_overlapping_vehicles_do_not_get_deeper_into_each_other():
    result = rollout_platoon(tensor(-2), tensor(10), 0.0, 0.0, model=reckless, duration=1)
    assert (result.gaps >= -2).all()


@pytest.mark.parametrize("model", [IDMParameters(), OVMParameters()])
def test_gradients_reach_every_input(model):
    inputs = [
        tensor(12, 18).requires_grad_(),
        tensor(9, 10).requires_grad_(),
        tensor(10).requires_grad_(),
        tensor(-1).requires_grad_(),
    ]

    def final_speeds(gaps, speeds, lead_speed, pulse):
        return rollout_platoon(
            gaps, speeds, lead_speed, pulse, duration=1, time_step=0.25, model=model
        ).speeds[-1]

    assert torch.autograd.gradcheck(final_speeds, inputs)
    for grad in torch.autograd.grad(final_speeds(*inputs).sum(), inputs):
        assert (grad != 0).all()


def test_gradients_stay_finite_through_a_stop():
    pulse = torch.tensor([-8.0], requires_grad=True)
    gaps, speeds = torch.full((5,), 8.0), torch.full((5,), 12.0)
    rollout_platoon(gaps, speeds, 6.0, pulse).speeds.mean().backward()
    assert torch.isfinite(pulse.grad).all()


def test_any_function_can_drive():
    def timid(speed, gap, lead_speed):
        return idm_acceleration(speed, gap, lead_speed) - 1.0

    state = tensor(15, 15), tensor(10, 10), 10.0, 0.0
    assert (rollout_platoon(*state, model=timid).gaps[-1] > rollout_platoon(*state).gaps[-1]).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time_step": 0}, "time_step must be more than 0"),
        ({"duration": 0}, "duration must be a multiple"),
        ({"duration": 1.05}, "duration must be a multiple"),
        ({"duration": math.inf}, "duration must be a multiple"),
        ({"hold": -1}, "hold must lie between 0 and duration"),
        ({"hold": 11}, "hold must lie between 0 and duration"),
        ({"max_speed": 0}, "max_speed must be more than 0"),
        ({"speeds": torch.ones(3)}, "same N"),
        ({"gaps": torch.ones(0), "speeds": torch.ones(0)}, "at least one follower"),
        ({"lead_speed": torch.ones(2)}, r"lead_speed must be a number or a tensor \[..., 1\]"),
        ({"lead_acceleration": torch.ones(3, 2)}, "lead_acceleration must be a number"),
    ],
)
def test_what_does_not_fit_is_named(changes, words):
    arguments = {"gaps": torch.ones(2), "speeds": torch.ones(2), "lead_speed": 1.0}
    arguments |= {"lead_acceleration": 0.0} | changes
    with pytest.raises(ValueError, match=words):
        rollout_platoon(**arguments)
