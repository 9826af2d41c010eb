import math
import pickle
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs.utils import ExplorationType, exploration_type, set_exploration_type
from torchrl.modules import ProbabilisticActor, TanhNormal

from haim_torchrl.mentors import DensityMentor, FunctionMentor, Mentor, PolicyMentor
from haim_torchrl.modules import make_actor


@pytest.fixture
def observation():
    return TensorDict(observation=torch.tensor([0.4, -0.2, 1.0]), action=torch.zeros(2))


@pytest.fixture
def actor():
    torch.manual_seed(0)
    return make_actor(3, 2)


def constant_actor(loc, scale, distribution=TanhNormal, **kwargs):
    """An actor whose distribution has the given parameters at every observation."""
    module = TensorDictModule(
        lambda x: (torch.tensor(loc), torch.tensor(scale)),
        in_keys=["observation"],
        out_keys=["loc", "scale"],
    )
    return ProbabilisticActor(
        module,
        in_keys=["loc", "scale"],
        distribution_class=distribution,
        distribution_kwargs=kwargs,
    )


def test_policies_and_functions_are_mentors(actor):
    assert isinstance(PolicyMentor(actor), Mentor)
    assert isinstance(PolicyMentor(actor), DensityMentor)
    assert isinstance(FunctionMentor(lambda simulator, tensordict: [0.0]), Mentor)
    assert not isinstance(FunctionMentor(lambda simulator, tensordict: [0.0]), DensityMentor)


def test_acts_deterministically_inside_a_random_collector(actor, observation):
    mentor = PolicyMentor(actor)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        expected = actor(observation.copy())["action"]
    with set_exploration_type(ExplorationType.RANDOM):
        first, second = (mentor.act(None, observation) for _ in range(2))
        assert exploration_type() == ExplorationType.RANDOM
    torch.testing.assert_close(first, expected.detach())
    assert torch.equal(first, second)
    assert first.shape == (2,)
    assert not first.requires_grad


def test_leaves_the_step_as_it_was(actor, observation):
    before = observation.clone()
    PolicyMentor(actor).act(None, observation)
    assert set(observation.keys()) == set(before.keys())
    assert torch.equal(observation["action"], before["action"])


def test_loader_runs_once_and_late(actor, observation):
    calls = []

    def load():
        calls.append(1)
        return actor

    mentor = PolicyMentor(load)
    assert not calls
    mentor.act(None, observation)
    mentor.act(None, observation)
    assert calls == [1]


def test_survives_pickling(actor, observation):
    mentor = PolicyMentor(partial(make_actor, 3, 2))
    assert pickle.loads(pickle.dumps(mentor)).act(None, observation).shape == (2,)


def test_switches_dropout_off(observation):
    policy = TensorDictModule(
        nn.Sequential(nn.Linear(3, 1), nn.Dropout(0.9)),
        in_keys=["observation"],
        out_keys=["action"],
    )
    mentor = PolicyMentor(policy)
    assert torch.equal(mentor.act(None, observation), mentor.act(None, observation))


def test_density_is_one_at_its_own_action_and_falls_off(actor, observation):
    mentor = PolicyMentor(actor)
    own = mentor.act(None, observation)
    near = mentor.density(None, observation, own + 0.05)
    far = mentor.density(None, observation, own - 0.6)
    assert mentor.density(None, observation, own) == 1.0
    assert 0.0 <= far < near <= 1.0


def test_density_of_a_normal_by_hand(observation):
    mentor = PolicyMentor(constant_actor([0.0, 0.0], [0.5, 0.25], torch.distributions.Normal))
    # exp(-1/2 ((0.5 / 0.5)^2 + (0.25 / 0.25)^2)) = exp(-1), the normalisations cancel
    density = mentor.density(None, observation, torch.tensor([0.5, -0.25]))
    assert density == pytest.approx(math.exp(-1.0), rel=1e-5)


def test_density_of_a_squashed_normal_by_hand(observation):
    # Wide (scale 1): squashed, its density has peaks at the bounds. atanh(0.5) = ln(3) / 2.
    mentor = PolicyMentor(constant_actor([0.0, 0.0], [1.0, 1.0]))
    density = mentor.density(None, observation, torch.tensor([0.5, 0.0]))
    assert density == pytest.approx(math.exp(-0.5 * (0.5 * math.log(3.0)) ** 2), rel=1e-4)


def test_density_of_a_deterministic_policy_names_the_way_out(observation):
    policy = TensorDictModule(nn.Linear(3, 1), in_keys=["observation"], out_keys=["action"])
    with pytest.raises(TypeError, match="kernel_only=True"):
        PolicyMentor(policy).density(None, observation, torch.zeros(1))


def test_missing_observation_is_named(actor):
    with pytest.raises(KeyError, match=r"observation.*offers.*pixels"):
        PolicyMentor(actor).act(None, TensorDict(pixels=torch.zeros(3)))


@pytest.mark.parametrize("policy", [nn.Linear(3, 1), 3])
def test_refuses_what_is_no_policy(policy):
    with pytest.raises(TypeError, match="TensorDict policy"):
        PolicyMentor(policy)


def test_refuses_what_the_loader_returns(observation):
    with pytest.raises(TypeError, match="loader returned int"):
        PolicyMentor(lambda: 3).act(None, observation)


def test_function_mentor_sees_simulator_and_step(observation):
    mentor = FunctionMentor(lambda simulator, step: [simulator, float(step["observation"][0])])
    mentor.reset(None)
    torch.testing.assert_close(mentor.act(0.25, observation), torch.tensor([0.25, 0.4]))


def test_function_mentor_refuses_values():
    with pytest.raises(TypeError, match="FunctionMentor wraps a function"):
        FunctionMentor([0.0])
