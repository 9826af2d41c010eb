import copy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TruncatedNormal

from haim_torchrl.collectors import ActingPolicy, as_acting_policy
from haim_torchrl.modules import make_actor


@pytest.fixture
def observation():
    return TensorDict(observation=torch.randn(3, generator=torch.Generator().manual_seed(0)))


def actions(policy, observation, exploration, number=5):
    torch.manual_seed(1)
    with set_exploration_type(exploration), torch.no_grad():
        return torch.stack([policy(observation.copy())["action"] for _ in range(number)])


SPECS = {
    "unit": None,
    "scaled": Bounded(torch.tensor([-2.0, 0.0]), torch.tensor([2.0, 0.5]), shape=(2,)),
}


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("exploration", [ExplorationType.RANDOM, ExplorationType.DETERMINISTIC])
def test_acts_as_the_actor_does(observation, spec, exploration):
    torch.manual_seed(0)
    kwargs = {"action_dim": 2} if SPECS[spec] is None else {"action_spec": SPECS[spec]}
    actor = make_actor(3, **kwargs)
    acting = as_acting_policy(actor)
    assert isinstance(acting, ActingPolicy)
    ours = actions(acting, observation, exploration)
    torch.testing.assert_close(ours, actions(actor, observation, exploration))
    assert (ours.std(0) > 0).all() == (exploration == ExplorationType.RANDOM)


def test_saturated_actions_stay_inside_the_bounds(observation):
    actor = make_actor(3, 2)
    with torch.no_grad():
        actor.module[0].module.layers[-1].bias[:2] = torch.tensor([50.0, -50.0])
    expected = actions(actor, observation, ExplorationType.DETERMINISTIC)
    ours = actions(as_acting_policy(actor), observation, ExplorationType.DETERMINISTIC)
    torch.testing.assert_close(ours, expected)
    assert (ours.abs() < 1.0).all()


def test_writes_the_action_and_nothing_else(observation):
    acting = as_acting_policy(make_actor(3, 2))
    assert acting.out_keys == ["action"]
    assert set(acting(observation.copy()).keys()) == {"observation", "action"}


def test_learns_with_the_actor(observation):
    actor = make_actor(3, 2)
    acting = as_acting_policy(actor)
    independent = copy.deepcopy(acting)
    before = actions(acting, observation, ExplorationType.DETERMINISTIC, 1)
    with torch.no_grad():
        for parameter in actor.parameters():
            parameter.add_(0.1)
    after = actions(acting, observation, ExplorationType.DETERMINISTIC, 1)
    assert not torch.equal(before, after)
    assert torch.equal(actions(independent, observation, ExplorationType.DETERMINISTIC, 1), before)
    independent.load_state_dict(acting.state_dict())
    assert torch.equal(actions(independent, observation, ExplorationType.DETERMINISTIC, 1), after)


def test_other_policies_are_left_alone(observation):
    deterministic = TensorDictModule(nn.Linear(3, 2), ["observation"], ["action"])
    truncated = ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(nn.Linear(3, 4), NormalParamExtractor()),
            ["observation"],
            ["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        distribution_class=TruncatedNormal,
    )
    scored = make_actor(3, 2, return_log_prob=True)
    for policy in (deterministic, truncated, scored):
        assert as_acting_policy(policy) is policy
