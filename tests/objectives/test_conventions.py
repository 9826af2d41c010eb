"""What TorchRL asks of its own losses, asked of each term and of the composite."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import pytest
import torch
from torchrl.objectives import SoftUpdate, ValueEstimators

from haim_torchrl.objectives import HAIMLoss, LinearPreferenceLoss

TERMS = ("proxy", "preference", "explicit", "implicit", "temperature", "actor")
CRITIC_TERMS = ("proxy", "explicit", "implicit")
#: Which network's parameters each loss reaches: these and no others.
GRADIENT_MAP = {
    "loss_proxy_q": {"proxy"},
    "loss_preference": {"proxy"},
    "loss_explicit": {"explicit"},
    "loss_implicit": {"implicit"},
    "loss_temperature": {"temperature"},
    "loss_actor": {"actor"},
}


def losses(result: Any) -> dict[str, torch.Tensor]:
    return {name: value for name, value in result.items() if name.startswith("loss_")}


@pytest.mark.parametrize("conservative", [False, True])
def test_each_loss_reaches_its_own_parameters_only(
    method_factory: Callable[..., Any], conservative: bool
) -> None:
    method = method_factory(conservative=conservative)
    result = method.loss(method.batch)
    assert set(losses(result)) == set(GRADIENT_MAP)
    owners = method.parameters()
    for name, loss in losses(result).items():
        flat = [p for parameters in owners.values() for p in parameters]
        gradients = torch.autograd.grad(loss, flat, retain_graph=True, allow_unused=True)
        reached = iter(gradients)
        touched = {
            owner: [next(reached) is not None for _ in parameters]
            for owner, parameters in owners.items()
        }
        assert {owner for owner, flags in touched.items() if any(flags)} == GRADIENT_MAP[name]
        assert all(all(touched[owner]) for owner in GRADIENT_MAP[name])


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


def test_diagnostics_carry_no_gradient(method: Any) -> None:
    result = method.loss(method.batch)
    for name, value in result.items():
        assert value.requires_grad == name.startswith("loss_"), name


def test_one_backward_pass_equals_one_per_term(method: Any) -> None:
    torch.manual_seed(1)
    sum(losses(method.loss(method.batch)).values()).backward()
    together = [p.grad.clone() for p in method.loss.parameters()]
    method.loss.zero_grad()
    torch.manual_seed(1)
    for loss in losses(method.loss(method.batch)).values():
        loss.backward(retain_graph=True)
    apart = [p.grad for p in method.loss.parameters()]
    torch.testing.assert_close(together, apart)


@pytest.mark.parametrize("name", TERMS)
def test_a_term_alone_gives_what_it_gives_in_the_composite(method: Any, name: str) -> None:
    """Sharing a forward pass changes nothing but the draws, which are equal for equal seeds."""
    term = method.loss.terms[name]
    torch.manual_seed(3)
    alone = term(method.batch)
    if name in ("temperature", "actor"):
        # The whole composite draws the next action before it draws the fresh one.
        pair = {key: method.loss.terms[key] for key in ("temperature", "actor")}
        composite = HAIMLoss(pair)
    else:
        composite = method.loss
    torch.manual_seed(3)
    together = composite(method.batch)
    for key, value in alone.items():
        torch.testing.assert_close(value, together[key])


@pytest.mark.parametrize("name", [*TERMS, "composite"])
def test_in_and_out_keys_are_what_is_read_and_written(method: Any, name: str) -> None:
    loss = method.loss if name == "composite" else method.loss.terms[name]
    result = loss(method.batch.select(*loss.in_keys))
    assert list(result.keys()) == list(loss.out_keys)
    for key in loss.in_keys:
        with pytest.raises(KeyError):
            loss(method.batch.select(*loss.in_keys).exclude(key))


@pytest.mark.parametrize("name", [*TERMS, "composite"])
def test_dispatch_without_a_tensordict(method: Any, name: str) -> None:
    loss = method.loss if name == "composite" else method.loss.terms[name]
    arguments = {
        key if isinstance(key, str) else "_".join(key): method.batch[key] for key in loss.in_keys
    }
    torch.manual_seed(0)
    values = loss(**arguments)
    torch.manual_seed(0)
    expected = loss(method.batch)
    values = values if isinstance(values, tuple) else (values,)
    for key, value in zip(loss.out_keys, values):
        torch.testing.assert_close(value, expected[key])


@pytest.mark.parametrize("name", TERMS)
def test_unknown_keys_are_refused(method: Any, name: str) -> None:
    with pytest.raises(ValueError, match="hat_size is not an accepted tensordict key"):
        method.loss.terms[name].set_keys(hat_size="large")
    with pytest.raises(ValueError, match="hat_size is not an accepted tensordict key"):
        method.loss.set_keys(hat_size="large")


@pytest.mark.parametrize("name", TERMS)
def test_keys_can_be_set_and_set_back(method: Any, name: str) -> None:
    term = method.loss.terms[name]
    for key in fields(term.default_keys):
        default = getattr(term.tensor_keys, key.name)
        term.set_keys(**{key.name: "renamed"})
        assert getattr(term.tensor_keys, key.name) == "renamed"
        term.set_keys(**{key.name: None})
        assert getattr(term.tensor_keys, key.name) == default


def test_entries_of_the_data_can_have_other_names(method: Any) -> None:
    torch.manual_seed(0)
    expected = method.loss(method.batch)
    renamed = method.batch.copy()
    for old, new in (
        ("action_agent", "proposal"),
        ("intervention", "taken_over"),
        (("next", "takeover_cost"), ("next", "price")),
        (("next", "terminated"), ("next", "ended")),
    ):
        renamed.rename_key_(old, new)
    method.loss.set_keys(action_agent="proposal", intervention="taken_over", terminated="ended")
    method.loss.terms["explicit"].set_keys(cost="price")
    method.loss.in_keys = None
    torch.manual_seed(0)
    torch.testing.assert_close(method.loss(renamed), expected)
    assert "proposal" in method.loss.in_keys and ("next", "price") in method.loss.in_keys


def test_a_missing_entry_is_named_with_its_reader(method: Any) -> None:
    with pytest.raises(KeyError, match=r"ImplicitInterventionLoss.*disturbance_cost"):
        method.loss(method.batch.exclude(("next", "disturbance_cost")))


def test_a_critic_that_reads_something_else_is_named(
    make_known_actor: Any, make_linear_critic: Any, batch: Any
) -> None:
    critic = make_linear_critic((1.0, 1.0), action="deed")
    with pytest.raises(ValueError, match="deed"):
        LinearPreferenceLoss(critic)(batch)
    term = LinearPreferenceLoss(critic)
    term.set_keys(action="deed")
    assert term(batch)["loss_preference"].item() == pytest.approx(-20.0 / 3)


@pytest.mark.parametrize("name", [*TERMS, "composite"])
def test_reduction(method_factory: Any, name: str) -> None:
    results = {}
    for reduction in ("none", "sum", "mean"):
        method = method_factory(reduction=reduction)
        loss = method.loss if name == "composite" else method.loss.terms[name]
        torch.manual_seed(5)
        results[reduction] = losses(loss(method.batch))
    for key, each in results["none"].items():
        assert each.shape == method.batch.shape
        torch.testing.assert_close(each.sum(), results["sum"][key])
        torch.testing.assert_close(each.mean(), results["mean"][key])


def test_unknown_reduction_is_refused(method_factory: Any) -> None:
    with pytest.raises(ValueError, match="median"):
        method_factory(reduction="median")


def test_masked_positions_do_not_count(method: Any) -> None:
    term = method.loss.terms["preference"]
    expected = term(method.batch[:4])["loss_preference"]
    batch = method.batch.clone()
    batch["observation"][4:] = float("nan")
    batch["collector"] = {"mask": torch.tensor([[True]] * 4 + [[False]] * 4)}
    torch.testing.assert_close(term(batch)["loss_preference"], expected)


def test_priority_weights_are_honoured(method: Any) -> None:
    term = method.loss.terms["preference"]
    weights = torch.zeros(8)
    weights[0] = 1.0
    batch = method.batch.clone().set("priority_weight", weights)
    alone = term(method.batch[:1])["loss_preference"]
    torch.testing.assert_close(term(batch)["loss_preference"], alone)


def test_temporal_differences_are_written_for_prioritised_replay(method: Any) -> None:
    method.loss(method.batch)
    for name in CRITIC_TERMS:
        priority = method.batch[method.loss.terms[name].tensor_keys.priority]
        assert priority.shape == (8,) and not priority.requires_grad


def test_the_batch_is_left_as_it_was_but_for_priorities(method: Any) -> None:
    before = method.batch.clone()
    method.loss(method.batch)
    added = set(method.batch.keys(True, True)) - set(before.keys(True, True))
    assert added == {"td_error", "explicit_td_error", "implicit_td_error"}
    for key in before.keys(True, True):
        torch.testing.assert_close(method.batch[key], before[key])


def test_batches_of_sequences(method: Any) -> None:
    """[4, 2] gives what [8] gives."""
    flat = method.loss.terms["preference"](method.batch)["loss_preference"]
    sequences = method.batch.reshape(4, 2)
    torch.testing.assert_close(method.loss.terms["preference"](sequences)["loss_preference"], flat)
    assert all(v.isfinite().all() for v in losses(method.loss(sequences)).values())


def test_state_dict_round_trip(method_factory: Any) -> None:
    source, other = method_factory(), method_factory()
    with torch.no_grad():
        for tensor in itertools.chain(source.loss.parameters(), source.loss.buffers()):
            tensor.add_(0.01)
    assert not torch.equal(next(source.actor.parameters()), next(other.actor.parameters()))
    other.loss.load_state_dict(copy.deepcopy(source.loss.state_dict()))
    torch.manual_seed(0)
    expected = source.loss(source.batch)
    torch.manual_seed(0)
    torch.testing.assert_close(other.loss(source.batch), expected)
    # Loading reaches the actor that collects, too.
    torch.testing.assert_close(list(other.actor.parameters()), list(source.actor.parameters()))


def test_a_deep_copy_is_a_world_of_its_own(method: Any) -> None:
    twin = copy.deepcopy(method.loss)
    torch.manual_seed(0)
    expected = method.loss(method.batch)
    torch.manual_seed(0)
    torch.testing.assert_close(twin(method.batch), expected)
    with torch.no_grad():
        for parameter in twin.parameters():
            parameter.add_(1.0)
    torch.manual_seed(0)
    torch.testing.assert_close(method.loss(method.batch), expected)
    torch.manual_seed(0)
    assert twin(method.batch)["loss_proxy_q"] != expected["loss_proxy_q"]


def test_other_floating_point_types(method: Any) -> None:
    method.loss.to(torch.float64)
    batch = method.batch.apply(lambda t: t.double() if t.is_floating_point() else t)
    assert all(v.dtype == torch.float64 for v in losses(method.loss(batch)).values())


@pytest.mark.parametrize("name", CRITIC_TERMS)
def test_value_estimator_sets_the_discount(method: Any, name: str) -> None:
    term = method.loss.terms[name]
    assert term.gamma.item() == pytest.approx(0.99)
    term.make_value_estimator(ValueEstimators.TD0, gamma=0.5)
    assert term.gamma.item() == 0.5
    with pytest.raises(NotImplementedError, match="TD0"):
        term.make_value_estimator(ValueEstimators.TDLambda)
    with pytest.raises(TypeError, match="lmbda"):
        term.make_value_estimator(lmbda=0.9)
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        term.make_value_estimator(gamma=1.5)


def test_composite_hands_the_discount_to_all_critics(method: Any) -> None:
    method.loss.make_value_estimator(gamma=0.9)
    discounts = [method.loss.terms[name].gamma.item() for name in CRITIC_TERMS]
    assert discounts == pytest.approx([0.9] * 3)


@pytest.mark.filterwarnings("ignore:Found an eps value")
def test_torchrls_own_soft_update_serves_a_single_term(method: Any) -> None:
    term = method.loss.terms["explicit"]
    with torch.no_grad():
        for parameter in term.trained_parameters():
            parameter.add_(1.0)
    SoftUpdate(term, tau=1.0).step()
    for online, target in zip(
        term.critic_network_params.values(True, True),
        term.target_critic_network_params.values(True, True),
    ):
        torch.testing.assert_close(online.detach(), target)


def test_parameters_can_be_drawn_anew(method: Any) -> None:
    before = [p.clone() for p in method.loss.parameters()]
    method.loss.reset_parameters_recursive()
    changed = [not torch.equal(p, old) for p, old in zip(method.loss.parameters(), before)]
    weights = [p.ndim > 0 for p in method.loss.parameters()]
    assert changed == weights  # all but the temperature, which goes back to its start
    for name in CRITIC_TERMS:
        term = method.loss.terms[name]
        torch.testing.assert_close(
            term.target_critic_network_params.data, term.critic_network_params.data
        )


def test_fresh_actions_are_draws_even_inside_a_deterministic_context(method: Any) -> None:
    from torchrl.envs.utils import ExplorationType, set_exploration_type

    with set_exploration_type(ExplorationType.DETERMINISTIC):
        first = method.loss(method.batch)["entropy"]
        second = method.loss(method.batch)["entropy"]
    assert first != second


@pytest.mark.filterwarnings("ignore")
def test_compiles_without_a_break_and_equals_eager(method: Any) -> None:
    terms = {name: method.loss.terms[name] for name in ("proxy", "preference", "actor")}
    loss = HAIMLoss(terms)
    compiled = torch.compile(loss, backend="eager", fullgraph=True)
    torch.manual_seed(0)
    expected = loss(method.batch)
    torch.manual_seed(0)
    torch.testing.assert_close(compiled(method.batch), expected)
