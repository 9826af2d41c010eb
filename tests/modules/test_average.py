"""The policy's average: values by hand, and what is kept."""

import pytest
import torch
from torch import nn

from haim_torchrl.modules import PolicyAverage


def constant(value: float) -> nn.Linear:
    layer = nn.Linear(1, 1, bias=False)
    nn.init.constant_(layer.weight, value)
    return layer


def test_average_starts_at_the_policy_and_follows_it() -> None:
    actor = constant(1.0)
    average = PolicyAverage(actor, decay=0.75)
    average.update()
    assert average.actor.weight.item() == pytest.approx(1.0)
    nn.init.constant_(actor.weight, 5.0)
    average.update()  # 0.75 * 1 + 0.25 * 5 = 2
    assert average.actor.weight.item() == pytest.approx(2.0)
    average.update()  # 0.75 * 2 + 0.25 * 5 = 2.75
    assert average.actor.weight.item() == pytest.approx(2.75)
    assert actor.weight.item() == 5.0


def test_without_decay_it_is_the_policy_itself() -> None:
    actor = constant(1.0)
    average = PolicyAverage(actor, decay=0.0)
    average.update()
    nn.init.constant_(actor.weight, -3.0)
    average.update()
    assert average.actor.weight.item() == pytest.approx(-3.0)


def test_saved_average_goes_on() -> None:
    actor = constant(1.0)
    average = PolicyAverage(actor, decay=0.5)
    average.update()
    nn.init.constant_(actor.weight, 3.0)
    average.update()
    other = PolicyAverage(actor, decay=0.5)
    other.load_state_dict(average.state_dict())
    for each in (average, other):
        each.update()
    assert torch.equal(average.actor.weight, other.actor.weight)
    assert other.actor.weight.item() == pytest.approx(2.5)


@pytest.mark.parametrize("decay", [-0.1, 1.0, 2.0])
def test_impossible_decay_is_refused(decay: float) -> None:
    with pytest.raises(ValueError, match=r"must be in \[0, 1\)"):
        PolicyAverage(constant(1.0), decay=decay)
