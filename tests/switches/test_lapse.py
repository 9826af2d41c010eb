import pytest
import torch

from haim_torchrl.switches import Always, Lapse, Never, Switch


def test_is_a_switch(scripted):
    assert isinstance(Lapse(scripted([True])), Switch)


def test_nothing_escapes_full_attention(run, scripted):
    answers = [False, True, False, True, True]
    assert run(Lapse(scripted(answers), rate=0.0), 5) == answers


def test_everything_escapes_none(run):
    assert run(Lapse(Always(), rate=1.0, steps=1), 6) == [False] * 6


def test_a_lapse_lasts_as_long_as_it_says(run, scripted, monkeypatch):
    draws = iter([0.0, 0.9])  # the first firing meets a lapse, the next one that is seen does not
    monkeypatch.setattr(torch, "rand", lambda *_: torch.tensor(next(draws)))
    switch = Lapse(scripted([False, True, True, False, True, True]), rate=0.5, steps=3)
    assert run(switch, 6) == [False, False, False, False, True, True]


def test_who_is_in_control_does_not_lapse(run, monkeypatch):
    draws = iter([0.9])  # asked once only
    monkeypatch.setattr(torch, "rand", lambda *_: torch.tensor(next(draws)))
    assert run(Lapse(Always(), rate=0.5), 20) == [True] * 20


def test_a_reset_ends_a_lapse(situation):
    switch = Lapse(Always(), rate=1.0, steps=100)
    assert not switch(situation()[0])
    switch.reset()
    switch.rate = 0.0
    assert switch(situation()[0])


def test_lapses_are_as_frequent_as_their_rate(situation):
    torch.manual_seed(0)
    switch = Lapse(Always(), rate=0.2, steps=1)
    seen = [switch(situation()[0]) for _ in range(4000)]
    assert 1.0 - sum(seen) / 4000 == pytest.approx(0.2, abs=0.02)  # three deviations


def test_impossible_values_are_refused():
    with pytest.raises(ValueError, match=r"rate is 1\.5"):
        Lapse(Never(), rate=1.5)
    with pytest.raises(ValueError, match="steps is 0"):
        Lapse(Never(), steps=0)
