"""Where gradients go: each loss of the method reaches its own network, alone and in the sum.

What TorchRL asks of any loss is asked in tests/conformance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from haim_torchrl.objectives import HAIMLoss
from haim_torchrl.objectives.composite import losses_of

#: Which network's parameters each loss reaches: these and no others.
GRADIENT_MAP = {
    "loss_proxy_q": {"proxy"},
    "loss_preference": {"proxy"},
    "loss_explicit": {"explicit"},
    "loss_implicit": {"implicit"},
    "loss_temperature": {"temperature"},
    "loss_actor": {"actor"},
}


@pytest.mark.parametrize("conservative", [False, True])
def test_each_loss_reaches_its_own_parameters_only(
    method_factory: Callable[..., Any], conservative: bool
) -> None:
    method = method_factory(conservative=conservative)
    result = method.loss(method.batch)
    assert set(losses_of(result)) == set(GRADIENT_MAP)
    owners = method.parameters()
    for name, reached_owners in GRADIENT_MAP.items():
        flat = [p for parameters in owners.values() for p in parameters]
        gradients = torch.autograd.grad(result[name], flat, retain_graph=True, allow_unused=True)
        reached = iter(gradients)
        touched = {
            owner: [next(reached) is not None for _ in parameters]
            for owner, parameters in owners.items()
        }
        assert {owner for owner, flags in touched.items() if any(flags)} == reached_owners
        assert all(all(touched[owner]) for owner in reached_owners)


@pytest.mark.parametrize("conservative", [False, True])
def test_trained_parameters_tell_the_truth(
    method_factory: Callable[..., Any], conservative: bool
) -> None:
    method = method_factory(conservative=conservative)
    result = method.loss(method.batch)
    for _, term in method.loss.named_terms():
        trained = {id(p) for p in term.trained_parameters()}
        others = [p for p in method.loss.parameters() if id(p) not in trained]
        loss = result[term.loss_name]
        own = torch.autograd.grad(loss, term.trained_parameters(), retain_graph=True)
        assert all(gradient.isfinite().all() for gradient in own)
        rest = torch.autograd.grad(loss, others, retain_graph=True, allow_unused=True)
        assert all(gradient is None for gradient in rest)


@pytest.mark.parametrize(
    "name", ["proxy", "preference", "explicit", "implicit", "temperature", "actor"]
)
def test_a_term_alone_gives_what_it_gives_in_the_composite(method: Any, name: str) -> None:
    """Sharing a forward pass changes neither values nor gradients, for equal draws."""
    term = method.loss.terms[name]
    torch.manual_seed(3)
    alone = term(method.batch)
    composite = method.loss
    if name in ("temperature", "actor"):
        # The whole composite draws the next action before it draws the fresh one.
        composite = HAIMLoss({key: method.loss.terms[key] for key in ("temperature", "actor")})
    torch.manual_seed(3)
    together = composite(method.batch)
    gradients = []
    for result in (alone, together):
        loss = result[term.loss_name]
        gradients.append(torch.autograd.grad(loss, term.trained_parameters(), retain_graph=True))
    torch.testing.assert_close(*gradients)
    for key, value in alone.items():
        torch.testing.assert_close(value, together[key])
