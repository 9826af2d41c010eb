import pytest
import torch
from torchrl.envs import Compose, GymEnv, Transform, TransformedEnv

from haim_torchrl.switches import ActionSwitch, Always
from haim_torchrl.transforms import InterventionKeys, check_intervention_specs


class Tamper(Transform):
    """Changes one published entry after the fact."""

    def __init__(self, key, change):
        super().__init__(in_keys=[], out_keys=[])
        self.key, self.change = key, change

    def _step(self, tensordict, next_tensordict):
        return next_tensordict.set(self.key, self.change(next_tensordict[self.key]))


@pytest.mark.parametrize(
    ("key", "change", "promise"),
    [
        ("takeover_start", torch.logical_not, "takeover_start is set exactly"),
        ("behavior_action", lambda a: a + 1.0, "the executed action"),
        ("action_agent", lambda a: a + 1.0, "the executed action|action_agent"),
        ("takeover_cost", lambda c: c + 1.0, "takeover_cost is zero"),
    ],
)
def test_a_broken_promise_is_named(pendulum, key, change, promise):
    env = pendulum(ActionSwitch(1.0), horizon=5, after=[Tamper(key, change)])
    with pytest.raises(ValueError, match=promise):
        check_intervention_specs(env)


def test_a_mentor_action_where_nobody_intervened(pendulum, scripted_switch):
    env = pendulum(scripted_switch([0]), after=[Tamper("action_mentor", torch.ones_like)])
    with pytest.raises(ValueError, match="action_mentor is zero"):
        check_intervention_specs(env)


def test_an_environment_without_takeovers():
    with pytest.raises(KeyError, match="give it an InterventionTransform"):
        check_intervention_specs(GymEnv("Pendulum-v1"))
    with pytest.raises(KeyError, match="give it an InterventionTransform"):
        check_intervention_specs(TransformedEnv(GymEnv("Pendulum-v1"), Compose()))


def test_other_names_must_be_said(pendulum):
    keys = InterventionKeys(takeover_cost="price")
    with pytest.raises(KeyError, match="price"):
        check_intervention_specs(pendulum(Always()), keys=keys)
    check_intervention_specs(pendulum(Always(), keys=keys), keys=keys)
