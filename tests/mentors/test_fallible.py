import copy
import functools

import pytest
import torch
from torchrl.envs import GymEnv, TransformedEnv

from haim_torchrl.envs import make_env
from haim_torchrl.mentors import FallibleMentor, FunctionMentor, Mentor, StatefulMentor
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import Always
from haim_torchrl.transforms import InterventionTransform, SimulatorRandomState


def steady(action=(0.5, -0.5)):
    return FunctionMentor(lambda simulator, tensordict: list(action))


def test_without_errors_it_is_the_other_mentor():
    mentor = FallibleMentor(steady(), rate=0.0, noise=0.0)
    assert isinstance(mentor, Mentor)
    assert mentor.act(None, None).tolist() == [0.5, -0.5]


def test_a_slip_is_kept_and_then_over():
    mentor = FallibleMentor(steady(), rate=1.0, steps=3, noise=0.0)
    actions = torch.stack([mentor.act(None, None) for _ in range(6)])
    assert (actions[0] == actions[:3]).all() and (actions[3] == actions[3:]).all()
    assert (actions[0] != actions[3]).any() and actions.abs().max() <= 1.0
    mentor.rate = 0.0
    assert mentor.act(None, None).tolist() == [0.5, -0.5]


def test_a_reset_ends_a_slip():
    mentor = FallibleMentor(steady(), rate=1.0, steps=100, noise=0.0)
    mentor.act(None, None)
    mentor.reset(None)
    mentor.rate = 0.0
    assert mentor.act(None, None).tolist() == [0.5, -0.5]


def test_slips_and_noise_are_as_large_as_they_say():
    mentor = FallibleMentor(steady((0.0, 0.0)), rate=0.0, noise=0.1)
    noise = torch.stack([mentor.act(None, None) for _ in range(4000)])
    assert noise.std().item() == pytest.approx(0.1, rel=0.05)
    mentor = FallibleMentor(steady((0.0, 0.0)), rate=0.05, steps=1, noise=0.0)
    slips = [bool(mentor.act(None, None).any()) for _ in range(4000)]
    assert sum(slips) / 4000 == pytest.approx(0.05, abs=0.011)  # three deviations


def test_actions_stay_within_their_range():
    mentor = FallibleMentor(steady((1.0, -1.0)), rate=0.0, noise=0.5)
    assert max(mentor.act(None, None).abs().max() for _ in range(100)) <= 1.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"rate": -0.1}, "rate is -0.1"),
        ({"steps": 0}, "steps is 0"),
        ({"noise": -1.0}, "noise -1"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_impossible_values_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        FallibleMentor(steady(), **arguments)


def test_something_that_is_no_mentor_is_refused():
    with pytest.raises(TypeError, match="mentor is object"):
        FallibleMentor(object())


def episodes(mentor, count=3, steps=4):
    """What the mentor does in episodes of a simulator without a generator, ``[count, steps]``."""
    driven = []
    for _ in range(count):
        mentor.reset(None)
        driven.append(torch.stack([mentor.act(None, None)[0] for _ in range(steps)]))
    return torch.stack(driven)


def test_the_seed_alone_decides_the_draws():
    first, second, other = (
        episodes(FallibleMentor(steady(), rate=0.3, seed=seed)) for seed in (1, 1, 2)
    )
    assert torch.equal(first, second) and not torch.equal(first, other)
    assert len(first.unique(dim=0)) == 3  # no episode repeats another


def test_nobody_elses_draws_are_used_up():
    torch.manual_seed(0)
    before = torch.get_rng_state()
    episodes(FallibleMentor(steady(), rate=0.5))
    assert torch.equal(torch.get_rng_state(), before)


def test_its_state_goes_on_with_the_next_episode():
    mentor = FallibleMentor(steady(), rate=0.3)
    assert isinstance(mentor, StatefulMentor)
    episodes(mentor)
    other = FallibleMentor(steady(), rate=0.3)
    other.set_state(copy.deepcopy(mentor.get_state()))
    assert torch.equal(episodes(other), episodes(mentor))


def test_another_mentors_state_is_kept():
    class Counting:
        resets = 0

        def reset(self, simulator):
            self.resets += 1

        def act(self, simulator, tensordict):
            return torch.zeros(2)

        def get_state(self):
            return {"resets": self.resets}

        def set_state(self, state):
            self.resets = state["resets"]

    mentor, other = FallibleMentor(Counting()), FallibleMentor(Counting())
    mentor.reset(None)
    other.set_state(mentor.get_state())
    assert other.mentor.resets == 1


@pytest.mark.parametrize("make", [functools.partial(make_env, horizon=5), None])
def test_a_resumed_environment_draws_what_it_would_have_drawn(make):
    def build():
        mentor = functools.partial(tired, size=2 if make else 1)
        base = make() if make else GymEnv("Pendulum-v1")
        env = TransformedEnv(base, InterventionTransform(mentor, Always()))
        return env.append_transform(SimulatorRandomState())

    def tired(size):
        inner = ExpertMentor() if size == 2 else steady((0.5,))
        return FallibleMentor(inner, rate=0.2, steps=2)

    env = build()
    env.set_seed(0)
    env.rollout(5)
    state = env.state_dict()
    expected = env.rollout(5)["next", "action_mentor"]
    other = build()
    other.set_seed(7)
    other.load_state_dict(state)
    assert torch.equal(other.rollout(5)["next", "action_mentor"], expected)
    env.close()
    other.close()
