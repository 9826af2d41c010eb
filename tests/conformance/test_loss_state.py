"""Parameters: reset, saving and loading, copies, number types, compilation."""

from __future__ import annotations

import copy
import io
import itertools

import pytest
import torch
from torchrl.objectives import LossModule

from .loss_case import LossCase, evaluate, gradients, losses_of, total
from .loss_cases import CASES, cases
from .networks import Networks, make_batch

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")
every_case = pytest.mark.parametrize("case", CASES, ids=str)


def shift(loss: LossModule, by: float) -> None:
    """Adds a number to all parameters and buffers, targets and coefficients among them."""
    with torch.no_grad():
        for tensor in itertools.chain(loss.parameters(), loss.buffers()):
            tensor.add_(by)


@every_case
def test_parameters_can_be_drawn_anew(case: LossCase) -> None:
    loss = case.build()
    networks = [m for name, m in loss.named_modules() if name.endswith("_network_params")]
    assert networks
    shift(loss, 1000.0)
    loss.reset_parameters_recursive()
    for tensor in (tensor for network in networks for tensor in network.values(True, True)):
        assert tensor.abs().max() < 100.0


@every_case
def test_state_goes_into_another_loss(case: LossCase) -> None:
    batch, networks = make_batch(), (Networks(seed=0), Networks(seed=1))
    source, other = (case.build_of(each) for each in networks)
    shift(source, 0.01)
    expected = losses_of(evaluate(source, batch))
    before = losses_of(evaluate(other, batch))
    assert any(not torch.equal(before[name], expected[name]) for name in expected)
    file = io.BytesIO()
    torch.save(source.state_dict(), file)
    file.seek(0)
    state = torch.load(file, weights_only=True)
    assert set(state) == set(other.state_dict())
    other.load_state_dict(state, strict=True)
    torch.testing.assert_close(losses_of(evaluate(other, batch)), expected)
    torch.testing.assert_close(dict(other.named_buffers()), dict(source.named_buffers()))
    # It reaches the networks that the loss was made of, among them the actor that collects.
    for name in case.shares:
        saved, loaded = (dict(each.made[name].named_parameters()) for each in networks)
        torch.testing.assert_close(loaded, saved)


@every_case
def test_a_deep_copy_is_a_world_of_its_own(case: LossCase) -> None:
    loss, batch = case.build(), make_batch()
    expected = evaluate(loss, batch)
    twin = copy.deepcopy(loss)
    torch.testing.assert_close(evaluate(twin, batch), expected)
    shift(twin, 0.1)
    torch.testing.assert_close(evaluate(loss, batch), expected)
    changed = evaluate(twin, batch)
    assert any(not torch.equal(changed[name], expected[name]) for name in case.losses)


@every_case
def test_double_precision(case: LossCase) -> None:
    """Also after a first call in single precision, of which nothing may be left."""
    loss, fresh, batch = case.build(), case.build(), make_batch()
    evaluate(loss, batch)
    batch = batch.apply(lambda t: t.double() if t.is_floating_point() else t)
    results = [losses_of(evaluate(each.to(torch.float64), batch)) for each in (loss, fresh)]
    torch.testing.assert_close(*results)
    assert all(value.dtype == torch.float64 for value in results[0].values())
    loss(batch)
    assert all(batch[key].dtype == torch.float64 for key in case.writes)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("case", cases(having="compiled"), ids=str)
def test_compiled_without_a_break_it_equals_eager(case: LossCase) -> None:
    loss, twin, batch = case.build(), case.build(), make_batch()
    expected = evaluate(loss, batch)
    torch.compiler.reset()
    found = evaluate(torch.compile(twin, backend="eager", fullgraph=True), batch)
    torch.testing.assert_close(found, expected)
    for result in (expected, found):
        total(result).backward()
    torch.testing.assert_close(gradients(twin), gradients(loss))


def test_every_kind_of_loss_is_compiled_somewhere() -> None:
    built, compiled = (
        {
            type(module)
            for case in some
            for module in case.build().modules()
            if isinstance(module, LossModule) and type(module).__module__.startswith("haim_torchrl")
        }
        for some in (CASES, cases(having="compiled"))
    )
    assert compiled == built
