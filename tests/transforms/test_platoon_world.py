"""The transforms on the world they are made for: a car, traffic, followers, and an expert."""

import pytest
import torch
from torchrl.envs import Compose, SerialEnv, TransformedEnv
from torchrl.envs.utils import step_mdp

from haim_torchrl.collectors import make_collector
from haim_torchrl.envs import make_env, make_gym_env
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.modules import make_actor
from haim_torchrl.switches import AnyOf, Hold, Never, ProbabilitySwitch, RiskSwitch
from haim_torchrl.transforms import (
    TRANSITION_TABLE,
    DisturbanceTransform,
    InterventionTransform,
    check_intervention_specs,
)

SHIELD = Hold(RiskSwitch(), 5)


def world(switch=SHIELD):
    takeover = InterventionTransform(ExpertMentor, switch)
    return TransformedEnv(make_env(), Compose(takeover, DisturbanceTransform()))


def drive(env, pedals, seed=0):
    """Drive scenario ``seed`` straight on with the given pedals until the episode ends."""
    step, steps = env.reset(seed=seed), []
    for pedal in pedals:
        step = env.step(step.set("action", torch.tensor([pedal, 0.0])))
        steps.append(step)
        if step["next", "done"]:
            break
        step = step_mdp(step)
    return torch.stack(steps)


def test_specs():
    check_intervention_specs(world())
    check_intervention_specs(SerialEnv(2, world))


def test_a_shield_keeps_a_blind_agent_on_the_road():
    full_speed = [1.0] * 150
    alone = drive(world(Never()), full_speed)
    shielded = drive(world(), full_speed)
    events = alone["next", "crash"] | alone["next", "out_of_road"]
    assert events[-1]
    assert not alone["next", "intervention"].any()
    assert shielded["next", "intervention"].any()
    assert shielded["next", "takeover_cost"][shielded["next", "takeover_start"]].gt(0).any()
    assert len(shielded) > len(alone)


def test_an_unlikely_action_is_taken_over_before_it_is_risky():
    both = Hold(AnyOf(RiskSwitch(), ProbabilitySwitch(eta=0.2)), 5)
    standing_still = [-0.5] * 8  # harmless, but nothing the expert would do on a free road
    assert not drive(world(), standing_still)["next", "intervention"].any()
    assert drive(world(both), standing_still)["next", "intervention"].all()


def test_hard_braking_of_the_agent_disturbs_once():
    rollout = drive(world(Never()), [0.5] * 30 + [-1.0] * 8)
    onset = rollout["next", "disturbance_onset"].squeeze(-1)
    assert onset.nonzero().squeeze(-1).tolist() == [30]
    assert rollout["next", "disturbance_cost"][30] > 0.0
    assert rollout["next", "disturbance"].sum() > 1
    assert rollout["next", "acceleration"][30].item() == pytest.approx(-8.0, abs=0.1)


def test_a_crash_is_no_hard_brake():
    rollout = drive(world(Never()), [1.0] * 150)
    assert rollout["next", "done"][-1]
    assert not rollout["next", "disturbance"].any()


def test_the_threshold_is_within_reach():
    simulator = make_gym_env().unwrapped
    DisturbanceTransform(min_acceleration=simulator.minimum_acceleration)
    with pytest.raises(ValueError, match="brakes with no more than"):
        DisturbanceTransform(-9.0, min_acceleration=simulator.minimum_acceleration)


def test_collected_transitions_have_the_documented_table():
    env = world()
    size = env.observation_spec["observation"].shape[-1]
    torch.manual_seed(0)
    collector = make_collector(
        world, make_actor(size, 2, hidden=(16,)), frames_per_batch=60, total_frames=60, seed=0
    )
    (batch,) = collector
    sizes = {"1": 1, "A": 2, "D": size}
    for row in TRANSITION_TABLE:
        entry = batch[row.name] if row.place == "root" else batch["next", row.name]
        assert entry.shape == (60, sizes[row.size]), row
        assert row.dtype is None or entry.dtype == row.dtype, row
    assert batch["intervention"].any()
