import numpy as np
import pytest

from haim_torchrl.switches import Forecast, Forecasting, RiskSwitch


class Oracle:
    """A simulator that foresees what it is told to, and keeps what it was asked."""

    def __init__(self, **forecast):
        self.known = Forecast(**forecast)
        self.asked = []

    def forecast(self, action):
        self.asked.append(action)
        return self.known


def decide(situation, switch, **forecast):
    step, calls = situation(agent=(0.5, -0.5), simulator=Oracle(**forecast))
    decision = switch(step)
    assert not calls  # a shield does not pay for a mentor
    return decision


@pytest.mark.parametrize(
    ("forecast", "expected"),
    [
        ({}, False),
        ({"collision": True, "time_to_collision": 3.0}, True),
        ({"departure": True, "time_to_departure": 2.0}, True),
        ({"lateral_acceleration": 4.0}, False),
        ({"lateral_acceleration": 4.1}, True),
        ({"stalled_steps": 19}, False),
        ({"stalled_steps": 20}, True),
    ],
)
def test_default_limits(situation, forecast, expected):
    assert decide(situation, RiskSwitch(), **forecast) is expected


@pytest.mark.parametrize(("time", "expected"), [(1.4, True), (1.5, False), (4.0, False)])
def test_least_time_to_collision(situation, time, expected):
    switch = RiskSwitch(min_time_to_collision=1.5)
    assert decide(situation, switch, collision=True, time_to_collision=time) is expected


@pytest.mark.parametrize(("time", "expected"), [(0.9, True), (1.1, False)])
def test_least_time_to_departure(situation, time, expected):
    switch = RiskSwitch(min_time_to_departure=1.0)
    assert decide(situation, switch, departure=True, time_to_departure=time) is expected


@pytest.mark.parametrize(
    ("off", "forecast"),
    [
        ({"collision": False}, {"collision": True, "time_to_collision": 0.1}),
        ({"departure": False}, {"departure": True, "time_to_departure": 0.1}),
        ({"max_lateral_acceleration": None}, {"lateral_acceleration": 20.0}),
        ({"max_stalled_steps": None}, {"stalled_steps": 500}),
    ],
)
def test_each_limit_can_be_off(situation, off, forecast):
    assert decide(situation, RiskSwitch(**off), **forecast) is False


@pytest.mark.parametrize(
    ("was_intervening", "clearance", "expected"),
    [(False, 1.0, False), (True, 1.0, True), (True, 1.5, False), (True, 3.0, False)],
)
def test_a_mentor_keeps_control_until_clear_of_the_edge(
    situation, was_intervening, clearance, expected
):
    step, _ = situation(simulator=Oracle(clearance=clearance), was_intervening=was_intervening)
    assert RiskSwitch(release_clearance=1.5)(step) is expected
    assert RiskSwitch()(step) is False


def test_forecast_is_for_the_agents_action(situation):
    simulator = Oracle()
    assert isinstance(simulator, Forecasting)
    RiskSwitch()(situation(agent=(0.5, -0.5), simulator=simulator)[0])
    assert isinstance(simulator.asked[0], np.ndarray)
    np.testing.assert_array_equal(simulator.asked[0], [0.5, -0.5])


def test_simulator_without_forecast(situation):
    with pytest.raises(TypeError, match=r"forecast\(action\).*object has none"):
        RiskSwitch()(situation(simulator=object())[0])


def test_a_switch_that_never_fires_is_refused():
    with pytest.raises(ValueError, match="never take over"):
        RiskSwitch(
            collision=False,
            departure=False,
            max_lateral_acceleration=None,
            max_stalled_steps=None,
        )


@pytest.mark.parametrize(
    "limit",
    [
        "max_lateral_acceleration",
        "max_stalled_steps",
        "min_time_to_collision",
        "min_time_to_departure",
        "release_clearance",
    ],
)
def test_limits_are_positive(limit):
    with pytest.raises(ValueError, match=f"{limit} is 0"):
        RiskSwitch(**{limit: 0})
