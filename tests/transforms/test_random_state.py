import io

import pytest
import torch
from torchrl.envs import GymEnv, TransformedEnv

from haim_torchrl.transforms import SimulatorRandomState


def make(**options):
    return TransformedEnv(GymEnv("Pendulum-v1"), SimulatorRandomState(**options))


def episodes(env, number):
    return [env.reset()["observation"] for _ in range(number)]


def test_the_sequence_of_episodes_goes_on():
    env = make()
    env.set_seed(0)
    episodes(env, 3)
    state = env.state_dict()
    expected = episodes(env, 4)
    other = make()
    other.set_seed(7)
    other.load_state_dict(state)
    for ours, theirs in zip(episodes(other, 4), expected):
        assert torch.equal(ours, theirs)


def test_state_can_be_saved_without_pickle():
    env = make()
    env.set_seed(0)
    file = io.BytesIO()
    torch.save(env.state_dict(), file)
    expected = env.reset()["observation"]
    file.seek(0)
    env.load_state_dict(torch.load(file, weights_only=True))
    assert torch.equal(env.reset()["observation"], expected)


@pytest.mark.parametrize("with_torch", [False, True])
def test_torch_state_on_demand(with_torch):
    env = make(with_torch=with_torch)
    torch.manual_seed(0)
    state = env.state_dict()
    first = torch.rand(3)
    env.load_state_dict(state)
    assert torch.equal(torch.rand(3), first) is with_torch
