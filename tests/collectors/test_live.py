"""The live collector: nothing lost, nothing twice, in order, and never waiting for the learner."""

import time
from functools import partial

import pytest
import torch
from torchrl.envs import TransformedEnv

from haim_torchrl.collectors import LiveCollector, LiveCollectorError, shutting_down
from haim_torchrl.envs import make_env
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.modules import make_actor
from haim_torchrl.switches import Hold, RiskSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform


def world():
    env = TransformedEnv(make_env(horizon=40, observation={"rays": 24}))
    env.append_transform(InterventionTransform(ExpertMentor, Hold(RiskSwitch(), 5)))
    env.append_transform(DisturbanceTransform())
    return env


class Failing(TransformedEnv):
    """Stops to work in its 21st step."""

    steps = 0

    def _step(self, tensordict):
        self.steps += 1
        if self.steps > 20:
            raise OSError("the simulator is gone")
        return super()._step(tensordict)


def failing_world():
    return Failing(world())


@pytest.fixture
def actor():
    env = world()
    torch.manual_seed(0)
    made = make_actor(env.observation_spec["observation"].shape[-1], action_spec=env.action_spec)
    env.close()
    return made


def test_hands_out_what_was_driven_while_the_learner_is_slow(actor):
    collector = LiveCollector(world, actor, total_frames=100_000, seed=0, pace=20.0)
    batches = []
    with shutting_down(collector):
        for batch in collector:
            if not batch.batch_size.numel():
                continue
            batches.append(batch)
            if len(batches) == 4:
                time.sleep(2.0)  # a slow update, and new weights after it
                saturate(actor)
                collector.update_policy_weights_()
            if len(batches) >= 10 and (batch["next", "policy_version"] > 0).all():
                break
    assert {len(batch) for batch in batches} == {5}
    steps = torch.cat(batches)
    done = steps["next", "done"].squeeze(-1)
    assert done.nonzero().squeeze(-1).tolist() == list(range(39, len(steps), 40))  # the horizon
    follows = steps["observation"][1:] == steps["next", "observation"][:-1]
    assert follows.all(-1)[~done[:-1]].all()
    times = steps["next", "step_time"].squeeze(-1)
    begins = list(range(0, len(steps), 40))  # of episodes
    assert (times == 0.0).nonzero().squeeze(-1).tolist() == begins
    assert steps["next", "device_ok"].all()
    # The slow learner delays nobody: what came while it was away was driven by the old policy.
    # An update may come while a step that was chosen before it waits for its time: the root counts.
    versions = steps["policy_version"].squeeze(-1)
    assert (versions.diff() >= 0).all() and (versions[:21] == 0).all() and versions[-1] > 0
    proposed = steps["action_agent"][:, 0]
    assert (proposed[versions > 0] > 0.9).all() and (proposed[versions == 0] < 0.9).any()


def saturate(actor):
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.zero_()
        list(actor.parameters())[-1].copy_(torch.tensor([9.0, 0.0, -5.0, -5.0]))


def test_says_that_the_driving_ended_and_goes_on_from_a_checkpoint(actor):
    collector = LiveCollector(failing_world, actor, total_frames=100, seed=0, pace=None)
    frames = 0
    with shutting_down(collector), pytest.raises(LiveCollectorError, match="has ended"):
        for batch in collector:
            frames += batch.batch_size.numel()
    assert frames == 20
    state = collector.state_dict()
    again = LiveCollector(world, actor, total_frames=30, seed=0, pace=None)
    again.load_state_dict(state)
    with shutting_down(again):
        assert sum(batch.batch_size.numel() for batch in again) == 10


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"total_frames": 0}, "total_frames 0"),
        ({"total_frames": 10, "frames_per_batch": 0}, "frames_per_batch is 0"),
        ({"total_frames": 10, "backlog": 5}, "backlog is 5"),
    ],
)
def test_settings_that_cannot_work(actor, settings, message):
    with pytest.raises(ValueError, match=message):
        partial(LiveCollector, world, actor)(**settings)
