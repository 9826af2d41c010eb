"""Disturbance cost (eq. 20) and its trigger (eq. 21)."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from haim_torchrl.traffic import (
    IDMParameters,
    OVMParameters,
    disturbance_cost,
    hard_brake,
    hard_brake_onset,
    mean_follower_speed,
    rollout_platoon,
)
from haim_torchrl.traffic import disturbance as disturbance_module

FLOAT64 = torch.float64


def tensor(*values):
    return torch.tensor(values, dtype=FLOAT64)


def numbers(low, high, size):
    return st.lists(st.floats(low, high), min_size=size, max_size=size)


@st.composite
def platoons(draw, dtype=FLOAT64):
    batch, followers = draw(st.integers(1, 3)), draw(st.integers(1, 6))
    gaps = torch.tensor(draw(numbers(0, 80, batch * followers)), dtype=dtype)
    speeds = torch.tensor(draw(numbers(0, 15, batch * followers)), dtype=dtype)
    lead_speed = torch.tensor(draw(numbers(0, 15, batch)), dtype=dtype)
    pulse = torch.tensor(draw(numbers(-12, 4, batch)), dtype=dtype)
    shape = (batch, followers)
    return gaps.view(shape), speeds.view(shape), lead_speed.view(-1, 1), pulse.view(-1, 1)


HOLDS = st.sampled_from([None, 0.0, 0.3, 2.0, 5.0])
EQUILIBRIUM = torch.full((5,), 15 / math.sqrt(1 - 16 / 81), dtype=FLOAT64), tensor(*[10] * 5)


def one_follower_by_hand():
    """Follower at 10 m/s, 20 m behind an AV at 10 m/s that brakes at -5 m/s^2; two steps of 1 s.

    Returns its speed after 1 s, and after 2 s with and without the brake.
    """
    # s* = 5 + 10 = 15; acc = 4*(1 - (10/15)^4 - (15/20)^2) = 4*(1 - 16/81 - 9/16)
    first = 10 + 4 * (1 - 16 / 81 - 9 / 16)
    way = (10 + first) / 2
    # the AV goes on 7.5 m to 5 m/s, or 10 m at 10 m/s
    results = [first]
    for lead_speed, lead_way in ((5.0, 7.5), (10.0, 10.0)):
        gap = 20 + lead_way - way
        desired_gap = 5 + first + first * (first - lead_speed) / 8
        results.append(first + 4 * (1 - (first / 15) ** 4 - (desired_gap / gap) ** 2))
    return results


HAND = tensor(20), tensor(10), tensor(10), tensor(-5)
TWO_STEPS = {"duration": 2, "time_step": 1}


def test_mean_speed_by_hand():
    # braking, second step: gap 20 + 7.5 - 10.479938 = 17.020062, s* = 24.124801,
    # acc = 4*(1 - 0.285006 - 2.009120) = -5.176511
    first, braked, _ = one_follower_by_hand()
    assert first == pytest.approx(10.959877, abs=1e-6)
    assert braked == pytest.approx(10.959877 - 5.176511, abs=1e-5)
    # eq. 8: three moments, the given one included
    result = mean_follower_speed(*HAND, **TWO_STEPS)
    torch.testing.assert_close(result, tensor((10 + first + braked) / 3))


def test_counterfactual_cost_by_hand():
    _, braked, free = one_follower_by_hand()
    # the first two of the three moments are the same in both predictions
    expected = 1 - math.exp(-(free - braked) / 3)
    torch.testing.assert_close(disturbance_cost(*HAND, **TWO_STEPS), tensor(expected))


def test_cost_against_the_current_speed_by_hand():
    first, braked, _ = one_follower_by_hand()
    loss = 10 - (10 + first + braked) / 3
    result = disturbance_cost(*HAND, **TWO_STEPS, reference="current")
    torch.testing.assert_close(result, tensor(1 - math.exp(-loss)))


def test_literal_cost_by_hand_rewards_braking():
    first, braked, _ = one_follower_by_hand()
    gain = (10 + first + braked) / 3 - 10
    result = disturbance_cost(*HAND, **TWO_STEPS, reference="literal")
    torch.testing.assert_close(result, tensor(1 - math.exp(-gain)))
    assert result < 0
    assert disturbance_cost(*EQUILIBRIUM, 10.0, -6.0, reference="literal") < -100


def test_driving_on_in_equilibrium_costs_nothing():
    for reference in ("counterfactual", "current"):
        cost = disturbance_cost(*EQUILIBRIUM, 10.0, 0.0, reference=reference)
        torch.testing.assert_close(cost, tensor(0), atol=1e-7, rtol=0)


def test_queueing_up_is_not_charged_to_the_av_but_compared_with_the_present_it_is():
    # fast followers close up to an AV that drives on at 5 m/s: they slow down whatever it does
    state = torch.full((5,), 15.0), torch.full((5,), 14.0), 5.0, 0.0
    assert disturbance_cost(*state) == 0
    assert disturbance_cost(*state, reference="current") > 0.9


def test_a_shorter_pulse_grades_the_cost():
    costs = [disturbance_cost(*EQUILIBRIUM, 10.0, -6.0, hold=h).item() for h in (0.2, 0.5, 1, 10)]
    assert costs == sorted(costs)
    assert 0.1 < costs[0] < 0.6
    assert costs[-1] > 0.95


@given(platoon=platoons(torch.float32), hold=HOLDS)
@settings(deadline=None, max_examples=60)
def test_cost_lies_in_zero_to_one(platoon, hold):
    for reference in ("counterfactual", "current"):
        cost = disturbance_cost(*platoon, reference=reference, hold=hold)
        assert cost.shape == (platoon[0].shape[0], 1)
        assert (cost >= 0).all()
        assert (cost < 1).all()


def test_cost_stays_below_one_where_rounding_would_reach_it():
    state = torch.full((5,), 6.0), torch.full((5,), 60.0), 60.0, -60.0
    cost = disturbance_cost(*state, reference="current", max_speed=100.0)
    assert 0.999 < cost < 1


@given(platoon=platoons(), hold=HOLDS, harder=st.floats(0, 8))
@settings(deadline=None, max_examples=60)
def test_braking_harder_never_costs_less(platoon, hold, harder):
    gaps, speeds, lead_speed, pulse = platoon
    cost = disturbance_cost(gaps, speeds, lead_speed, pulse, hold=hold)
    more = disturbance_cost(gaps, speeds, lead_speed, pulse - harder, hold=hold)
    assert (more >= cost - 1e-9).all()


@given(platoon=platoons(), hold=HOLDS)
@settings(deadline=None, max_examples=30)
def test_speeding_up_costs_nothing(platoon, hold):
    gaps, speeds, lead_speed, pulse = platoon
    cost = disturbance_cost(gaps, speeds, lead_speed, pulse.abs(), hold=hold)
    torch.testing.assert_close(cost, torch.zeros_like(cost), atol=1e-9, rtol=0)


DRIVERS = st.sampled_from(
    [
        IDMParameters(),
        IDMParameters(s0=2, time_headway=1.5, max_acceleration=1.5, comfortable_deceleration=2),
        IDMParameters(desired_speed=12, exponent=3.5),
        IDMParameters(desired_speed=0),
    ]
)


@given(platoon=platoons(), hold=HOLDS, model=DRIVERS)
@settings(deadline=None, max_examples=60)
def test_compiled_loop_equals_the_tensor_path(platoon, hold, model):
    compiled = mean_follower_speed(*platoon, hold=hold, model=model, duration=6)
    speeds = rollout_platoon(*platoon, hold=hold, model=model, duration=6).speeds
    expected = speeds.mean(dim=(-2, -1)).unsqueeze(-1)
    torch.testing.assert_close(compiled, expected, atol=1e-7, rtol=1e-7)


def test_compiled_loop_slows_a_follower_that_touches():
    # a driver who hardly brakes, 0.9 m behind a vehicle 10 m/s slower: in one step it would go
    # about 1.46 m at -0.001*(15*10/2/0.9)^2 = -6.9 m/s^2, and has 0.9 + 0.5 m: 15 -> 5 m/s
    weak = IDMParameters(s0=0, time_headway=0, max_acceleration=1e-3, comfortable_deceleration=1e3)
    state = tensor(0.9), tensor(15), 5.0, 0.0
    result = mean_follower_speed(*state, duration=0.1, model=weak)
    torch.testing.assert_close(result, tensor((15 + 5) / 2))


@given(platoon=platoons(torch.float32))
@settings(deadline=None, max_examples=15)
def test_gradient_path_gives_the_same_cost(platoon):
    plain = disturbance_cost(*platoon)
    differentiable = disturbance_cost(*platoon[:3], platoon[3].clone().requires_grad_())
    assert differentiable.requires_grad
    torch.testing.assert_close(plain, differentiable.detach(), atol=1e-4, rtol=1e-4)


def test_compiled_loop_is_used_without_gradients_only(monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("took the tensor path")

    monkeypatch.setattr(disturbance_module, "rollout_platoon", refuse)
    gaps, speeds = torch.full((5,), 15.0), torch.full((5,), 10.0)
    disturbance_cost(gaps, speeds, 10.0, -6.0)
    with torch.no_grad():
        disturbance_cost(gaps.clone().requires_grad_(), speeds, 10.0, -6.0)
    for state, model in (
        ((gaps.clone().requires_grad_(), speeds), IDMParameters()),
        ((gaps, speeds), OVMParameters()),
        ((gaps.to("meta"), speeds.to("meta")), IDMParameters()),
    ):
        with pytest.raises(AssertionError, match="tensor path"):
            disturbance_cost(*state, 10.0, -6.0, model=model)


def test_a_harder_brake_costs_more_by_the_gradient_too():
    pulse = tensor(-1).requires_grad_()
    cost = disturbance_cost(*EQUILIBRIUM, 10.0, pulse, hold=1.0)
    (gradient,) = torch.autograd.grad(cost, pulse)
    step = 1e-4
    ahead, behind = (
        disturbance_cost(*EQUILIBRIUM, 10.0, -1.0 + change, hold=1.0) for change in (step, -step)
    )
    torch.testing.assert_close(gradient, (ahead - behind) / (2 * step), atol=1e-5, rtol=1e-4)
    assert gradient < 0


@pytest.mark.parametrize("batch", [(), (1,), (4,), (2, 3)])
@pytest.mark.parametrize("model", [IDMParameters(), OVMParameters()])
def test_batch_shapes(batch, model):
    generator = torch.Generator().manual_seed(1)
    gaps, speeds = (torch.rand(*batch, 5, generator=generator) * 20 for _ in range(2))
    lead_speed = torch.rand(*batch, 1, generator=generator) * 15
    pulse = torch.rand(*batch, 1, generator=generator) * 12 - 8
    cost = disturbance_cost(gaps, speeds, lead_speed, pulse, model=model, duration=2)
    assert cost.shape == (*batch, 1)
    assert cost.dtype == torch.float32
    last = (-1,) * len(batch)
    one = disturbance_cost(
        gaps[last], speeds[last], lead_speed[last], pulse[last], model=model, duration=2
    )
    torch.testing.assert_close(cost[last], one)


def test_one_state_under_many_actions():
    pulses = torch.linspace(-8, 0, 9, dtype=FLOAT64).unsqueeze(-1)
    costs = disturbance_cost(*EQUILIBRIUM, 10.0, pulses, hold=0.5)
    assert costs.shape == (9, 1)
    assert (costs.flatten().diff() < 0).all()
    torch.testing.assert_close(costs[2], disturbance_cost(*EQUILIBRIUM, 10.0, -6.0, hold=0.5))


DEVICES = [
    "meta",
    pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")),
]


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("reference", ["counterfactual", "current", "literal"])
def test_stays_on_the_device_of_its_inputs(device, reference):
    gaps, speeds = torch.full((3, 5), 15.0), torch.full((3, 5), 10.0)
    options = {"reference": reference, "duration": 1.0}
    cost = disturbance_cost(gaps.to(device), speeds.to(device), 10.0, -6.0, **options)
    assert cost.device.type == device
    assert cost.shape == (3, 1)
    if device != "meta":
        torch.testing.assert_close(
            cost.cpu(), disturbance_cost(gaps, speeds, 10.0, -6.0, **options)
        )


def test_numbers_keep_the_precision_of_the_tensors():
    gaps, speeds = EQUILIBRIUM
    for pulse in (-0.1, -1.3):
        as_number = disturbance_cost(gaps, speeds, 10.1, pulse)
        as_tensor = disturbance_cost(gaps, speeds, tensor(10.1), tensor(pulse))
        assert torch.equal(as_number, as_tensor)


def test_inputs_are_left_alone():
    state = torch.full((2, 5), 15.0), torch.full((2, 5), 10.0), torch.ones(2, 1), -torch.ones(2, 1)
    before = [part.clone() for part in state]
    disturbance_cost(*state)
    rollout_platoon(*state)
    for part, copy in zip(state, before, strict=True):
        assert torch.equal(part, copy)


def test_hard_brake_includes_the_threshold():
    acceleration = torch.tensor([[-5.1], [-5.0], [-4.9], [4.0]])
    assert hard_brake(acceleration).tolist() == [[True], [True], [False], [False]]
    assert hard_brake(acceleration, threshold=-5.05).flatten().tolist() == [
        True,
        False,
        False,
        False,
    ]


def test_the_cost_is_charged_at_the_onset_and_as_printed_at_the_release():
    series = torch.tensor([0.0, -5.0, -8.0, -6.0, -1.0, 0.0, -7.0, -7.0])
    onset = hard_brake_onset(series[1:], series[:-1])
    assert onset.tolist() == [True, False, False, False, False, True, False]
    literal = hard_brake_onset(series[1:], series[:-1], literal=True)
    assert literal.tolist() == [False, False, False, True, False, False, False]


@given(series=st.lists(st.floats(-8, 4), min_size=2, max_size=40))
@settings(deadline=None)
def test_onsets_are_the_rising_edges_of_the_flag(series):
    acceleration = torch.tensor(series)
    flag = hard_brake(acceleration)
    onset = hard_brake_onset(acceleration[1:], acceleration[:-1])
    assert torch.equal(onset, flag[1:] & ~flag[:-1])


@pytest.mark.parametrize("threshold", [0.0, 5.0, math.nan])
def test_a_threshold_that_is_no_braking_is_refused(threshold):
    zero = torch.zeros(1)
    with pytest.raises(ValueError, match=r"threshold \(lambda\) must be a negative acceleration"):
        hard_brake(zero, threshold)
    with pytest.raises(ValueError, match=r"threshold \(lambda\) must be a negative acceleration"):
        hard_brake_onset(zero, zero, threshold)


def test_unknown_reference_is_refused():
    with pytest.raises(
        ValueError, match="reference must be one of counterfactual, current, literal"
    ):
        disturbance_cost(torch.ones(1), torch.ones(1), 1.0, 0.0, reference="mean")


@pytest.mark.parametrize("field", ["max_speed", "duration", "time_step"])
def test_the_compiled_path_checks_its_settings_too(field):
    with pytest.raises(ValueError, match=f"^{field} must be"):
        disturbance_cost(torch.ones(1), torch.ones(1), 1.0, 0.0, **{field: -1.0})
