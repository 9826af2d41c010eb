import math

import pytest

from haim_torchrl.switches import ActionSwitch


@pytest.mark.parametrize(("norm", "distance"), [("l2", math.sqrt(0.25 + 0.0625)), ("linf", 0.5)])
def test_distance_by_hand(situation, norm, distance):
    step, _ = situation(agent=(0.75, -0.25), mentor=(0.25, -0.5))
    switch = ActionSwitch(threshold=0.5, norm=norm)
    assert switch.distance(step) == pytest.approx(distance, rel=1e-6)


def test_takes_over_beyond_the_threshold_only(situation):
    step, _ = situation(agent=(0.5, 0.0), mentor=(0.0, 0.0))
    assert ActionSwitch(threshold=0.5)(step) is False
    assert ActionSwitch(threshold=0.49)(step) is True


def test_mentor_is_asked_once_a_step(situation):
    step, calls = situation(agent=(0.5, 0.0))
    ActionSwitch()(step)
    ActionSwitch()(step)
    step.mentor_action()
    assert calls == [1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"threshold": -0.1}, "cannot be below 0"), ({"norm": "l1"}, "choose 'l2' or 'linf'")],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        ActionSwitch(**arguments)
