"""The entropy temperature."""

from __future__ import annotations

import pytest
import torch

from haim_torchrl.modules import Temperature, as_temperature


def test_it_starts_where_it_is_told_and_gives_no_gradient() -> None:
    temperature = Temperature(0.2)
    assert temperature().item() == pytest.approx(0.2)
    assert not temperature().requires_grad
    assert [p.requires_grad for p in temperature.parameters()] == [True]


def test_a_constant_has_no_parameter_but_is_saved() -> None:
    temperature = as_temperature(0.2)
    assert not temperature.learnable and not list(temperature.parameters())
    other = Temperature(1.0, learnable=False)
    other.load_state_dict(temperature.state_dict())
    assert other().item() == pytest.approx(0.2)


def test_a_temperature_is_taken_as_it_is() -> None:
    temperature = Temperature()
    assert as_temperature(temperature) is temperature


def test_it_can_be_set_back() -> None:
    temperature = Temperature(0.5)
    with torch.no_grad():
        temperature.log_alpha.add_(3.0)
    temperature.reset_parameters()
    assert temperature().item() == pytest.approx(0.5)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_it_must_be_positive(value: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        Temperature(value)


@pytest.mark.parametrize("value", ["auto", None, True])
def test_anything_else_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="temperature must be"):
        as_temperature(value)
