import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torchrl.envs import GymEnv, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import Always, Never
from haim_torchrl.traffic import disturbance_cost
from haim_torchrl.transforms import (
    DisturbanceKeys,
    DisturbanceTransform,
    InterventionTransform,
    check_intervention_specs,
)


def follow(env, pedals):
    """Steps with the given pedals (acceleration in units of the action) and stacks the result."""
    step, steps = env.reset(), []
    for pedal in pedals:
        step = env.step(step.set("action", torch.tensor([pedal, 0.0])))
        steps.append(step)
        step = step_mdp(step)
    return torch.stack(steps)


def pedal(position):
    return lambda: FunctionMentor(lambda simulator, step: [position, 0.0])


def column(rollout, key):
    return rollout["next", key].squeeze(-1).tolist()


def test_charged_at_the_onset_only_and_from_the_state_before(car):
    # -8 m/s² at pedal -1, -4 at -0.5; from 12 m/s: 11.2, 10.4, 10.0, 9.2, ...
    rollout = follow(car(DisturbanceTransform()), [0.0, -1.0, -1.0, -0.5, -1.0])
    assert column(rollout, "disturbance") == [False, True, True, False, True]
    assert column(rollout, "disturbance_onset") == [False, True, False, False, True]
    costs = column(rollout, "disturbance_cost")
    gaps, speeds = torch.tensor([15.0, 15.0]), torch.tensor([12.0, 12.0])
    first = disturbance_cost(gaps, speeds, 12.0, rollout["next", "acceleration"][1].item())
    last = disturbance_cost(gaps, speeds, 10.0, rollout["next", "acceleration"][4].item())
    assert costs == pytest.approx([0.0, first.item(), 0.0, 0.0, last.item()], rel=1e-4)
    assert costs[1] > 0.9


def test_gentle_braking_is_free(car):
    rollout = follow(car(DisturbanceTransform()), [-0.5, -0.6, 0.5, 1.0])
    for key in ("disturbance", "disturbance_onset", "disturbance_cost"):
        assert not rollout["next", key].any()


def test_options_reach_the_prediction(car):
    graded = follow(car(DisturbanceTransform(hold=0.5)), [-1.0])
    held = follow(car(DisturbanceTransform()), [-1.0])
    assert 0.0 < column(graded, "disturbance_cost")[0] < column(held, "disturbance_cost")[0]
    current = follow(car(DisturbanceTransform(reference="current", time_step=0.2)), [-1.0])
    expected = disturbance_cost(
        torch.tensor([15.0, 15.0]),
        torch.tensor([12.0, 12.0]),
        12.0,
        current["next", "acceleration"][0],
        reference="current",
        time_step=0.2,
    )
    assert column(current, "disturbance_cost") == pytest.approx([expected.item()])


def test_threshold_decides_what_is_hard(car):
    assert column(follow(car(DisturbanceTransform(-3.0)), [-0.5]), "disturbance") == [True]
    assert column(follow(car(DisturbanceTransform(-5.0)), [-0.5]), "disturbance") == [False]


def test_literal_onset_fires_at_the_release(car):
    rollout = follow(car(DisturbanceTransform(literal_onset=True)), [-1.0, -1.0, 0.0, 0.0])
    assert column(rollout, "disturbance_onset") == [False, False, True, False]


def test_the_mentors_braking_is_not_charged(car):
    env = car(InterventionTransform(pedal(-1.0), Always()), DisturbanceTransform())
    check_intervention_specs(env)
    rollout = follow(env, [0.0, 0.0])
    assert (rollout["next", "acceleration"] < -5.0).all()
    for key in ("disturbance", "disturbance_onset", "disturbance_cost"):
        assert not rollout["next", key].any()


def test_standing_before_the_intervention_is_noticed(car):
    env = car(DisturbanceTransform(), InterventionTransform(pedal(0.0), Never()))
    with pytest.raises(RuntimeError, match="put it after"):
        follow(env, [-1.0])


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.lists(st.sampled_from([-1.0, -0.7, -0.5, 0.0, 1.0]), min_size=1, max_size=10))
def test_cost_is_in_the_unit_interval_and_only_at_rising_flags(car, pedals):
    rollout = follow(car(DisturbanceTransform()), pedals)
    flags, onsets = column(rollout, "disturbance"), column(rollout, "disturbance_onset")
    costs = column(rollout, "disturbance_cost")
    for now, before, onset, cost in zip(flags, [False, *flags], onsets, costs):
        assert onset == (now and not before)
        assert 0.0 <= cost < 1.0
        assert onset or cost == 0.0


def test_unreachable_threshold():
    with pytest.raises(ValueError, match=r"brakes with no more than -5\.0"):
        DisturbanceTransform(-6.0, min_acceleration=-5.0)
    DisturbanceTransform(-5.0, min_acceleration=-8.0)


@pytest.mark.parametrize(
    "arguments", [{"threshold": 5.0}, {"reference": "mean"}, {"duration": -1.0}]
)
def test_bad_options_at_once(arguments):
    with pytest.raises(ValueError):
        DisturbanceTransform(**arguments)


def test_missing_entries_are_named():
    env = TransformedEnv(GymEnv("Pendulum-v1"), DisturbanceTransform())
    with pytest.raises(KeyError, match="no acceleration, follower_gaps, follower_speeds, speed"):
        env.reset()


def test_renamed_entries(car):
    keys = DisturbanceKeys(disturbance_cost="braking_cost")
    rollout = follow(car(DisturbanceTransform(keys=keys)), [-1.0])
    assert column(rollout, "braking_cost")[0] > 0.9
