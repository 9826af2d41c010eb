import pytest
import torch

from haim_torchrl.mentors import FallibleMentor, FunctionMentor, Mentor


def steady(action=(0.5, -0.5)):
    return FunctionMentor(lambda simulator, tensordict: list(action))


def test_without_errors_it_is_the_other_mentor():
    mentor = FallibleMentor(steady(), rate=0.0, noise=0.0)
    assert isinstance(mentor, Mentor)
    assert mentor.act(None, None).tolist() == [0.5, -0.5]


def test_a_slip_is_kept_and_then_over():
    torch.manual_seed(0)
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
    torch.manual_seed(0)
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
    [({"rate": -0.1}, "rate is -0.1"), ({"steps": 0}, "steps is 0"), ({"noise": -1.0}, "noise -1")],
)
def test_impossible_values_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        FallibleMentor(steady(), **arguments)


def test_something_that_is_no_mentor_is_refused():
    with pytest.raises(TypeError, match="mentor is object"):
        FallibleMentor(object())
