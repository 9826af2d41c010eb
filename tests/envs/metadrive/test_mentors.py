"""Every mentor for MetaDrive drives."""

import numpy as np
import pytest
import torch

from haim_torchrl.envs.metadrive.mentors import IDMMentor, PPOExpertMentor
from haim_torchrl.mentors import DensityMentor, Mentor
from haim_torchrl.mentors.expert import ExpertMentor


@pytest.mark.parametrize("mentor", [ExpertMentor(), IDMMentor(), PPOExpertMentor()])
def test_it_gets_going_and_keeps_to_the_road(make_simulator, mentor):
    simulator = make_simulator()
    assert isinstance(mentor, Mentor)
    _, info = simulator.reset(seed=1)
    mentor.reset(simulator)
    for _ in range(60):
        action = mentor.act(simulator, None)
        assert action.shape == (2,)
        assert action.abs().max() <= 1.0
        *_, terminated, _, info = simulator.step(action.numpy())
        assert not terminated
    assert info["progress"] > 0.02
    assert info["cost"] == 0.0


def test_the_ppo_expert_finds_its_own_action_likeliest(make_simulator):
    simulator, mentor = make_simulator(), PPOExpertMentor()
    assert isinstance(mentor, DensityMentor)
    simulator.reset(seed=0)
    mentor.reset(simulator)
    for _ in range(10):
        simulator.step(np.array([0.5, 0.0]))
    own = mentor.act(simulator, None)
    other = (own + torch.tensor([-0.3, 0.2])).clamp(-1.0, 1.0)
    assert (
        0.0 <= mentor.density(simulator, None, other) < mentor.density(simulator, None, own) <= 1.0
    )
