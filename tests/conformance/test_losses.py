"""What TorchRL asks of its losses, asked of every loss: what a call takes and what it gives.

The other files of this suite ask about names of entries, the discount, targets and state.
"""

from __future__ import annotations

import inspect

import pytest
import torch
from tensordict import NestedKey, TensorDict, unravel_key
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import LossModule

from haim_torchrl import objectives

from .loss_case import LossCase, evaluate, gradients, losses_of, total
from .loss_cases import CASES, cases
from .networks import make_batch

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")
every_case = pytest.mark.parametrize("case", CASES, ids=str)


def argument(key: NestedKey) -> str:
    """How an entry is named in a call without a tensordict."""
    return key if isinstance(key, str) else "_".join(key)


def test_every_loss_of_the_package_has_a_case() -> None:
    exported = (getattr(objectives, name) for name in objectives.__all__)
    concrete = {
        kind
        for kind in exported
        if inspect.isclass(kind) and issubclass(kind, LossModule) and not inspect.isabstract(kind)
    }
    assert concrete
    assert concrete <= {type(case.build()) for case in CASES}


@every_case
def test_in_keys_are_what_is_read(case: LossCase) -> None:
    loss, batch = case.build(), make_batch()
    assert {unravel_key(key) for key in loss.in_keys} == case.reads
    assert len(loss.in_keys) == len(case.reads)
    expected = evaluate(loss, batch)
    torch.testing.assert_close(evaluate(loss, batch.select(*loss.in_keys)), expected)
    for key in case.reads - case.not_missed:
        with pytest.raises(KeyError) as error:
            evaluate(loss, batch.exclude(key))
        assert repr(key) in error.value.args[0]


@every_case
def test_out_keys_are_what_is_written(case: LossCase) -> None:
    loss = case.build()
    result = evaluate(loss, make_batch())
    assert sorted(result) == sorted(loss.out_keys)
    assert sorted(losses_of(result)) == sorted(case.losses)


@every_case
def test_a_call_without_a_tensordict(case: LossCase) -> None:
    loss, batch = case.build(), make_batch()
    expected = evaluate(loss, batch)
    torch.manual_seed(0)
    values = loss(**{argument(key): batch[key] for key in loss.in_keys})
    values = values if isinstance(values, tuple) else (values,)
    torch.testing.assert_close(dict(zip(loss.out_keys, values)), expected)


@every_case
def test_one_entry_of_the_result_can_be_selected(case: LossCase) -> None:
    loss, batch, wanted = case.build(), make_batch(), case.losses[-1]
    expected = evaluate(loss, batch)[wanted]
    loss.select_out_keys(wanted)
    torch.testing.assert_close(evaluate(loss, batch), {wanted: expected})
    torch.manual_seed(0)
    alone = loss(**{argument(key): batch[key] for key in loss.in_keys})
    torch.testing.assert_close(alone, expected)


@every_case
def test_reductions(case: LossCase) -> None:
    batch = make_batch()
    none, summed, mean, default = (
        losses_of(evaluate(case.build(reduction=reduction), batch))
        for reduction in ("none", "sum", "mean", None)
    )
    torch.testing.assert_close(default, mean)
    assert set(none) == set(summed) == set(mean) == set(case.losses)
    for name, each in none.items():
        counted = case.counted(name, batch)
        assert each.shape == batch.shape
        assert (each[~counted] == 0.0).all()
        torch.testing.assert_close(summed[name], each.sum())
        torch.testing.assert_close(mean[name], each[counted].mean())


@every_case
def test_an_unknown_reduction_is_refused(case: LossCase) -> None:
    with pytest.raises(case.error_of_reduction, match="median"):
        evaluate(case.build(reduction="median"), make_batch())


@every_case
def test_priority_weights_weigh_the_mean(case: LossCase) -> None:
    batch, weights = make_batch(), torch.arange(1.0, 9.0)
    none = losses_of(evaluate(case.build(reduction="none"), batch))
    weighted = losses_of(evaluate(case.build(), batch.copy().set("priority_weight", weights)))
    for name, each in none.items():
        expected = (each * weights).sum() / weights[case.counted(name, batch)].sum()
        torch.testing.assert_close(weighted[name], expected)


@every_case
def test_padding_does_not_count(case: LossCase) -> None:
    """TorchRL's samplers pad the ends of sequences and mark this at ``collector.mask``."""
    batch, real = make_batch(), torch.arange(8) < 5
    none = losses_of(evaluate(case.build(reduction="none"), batch))
    mask = real.unsqueeze(-1)
    padded = batch.apply(lambda t: t.masked_fill(~mask, 1e4) if t.is_floating_point() else t)
    padded["collector"] = TensorDict(mask=mask, batch_size=[8])
    masked = losses_of(evaluate(case.build(), padded))
    for name, each in none.items():
        expected = each[real & case.counted(name, batch)].mean()
        torch.testing.assert_close(masked[name], expected)


@pytest.mark.parametrize("reduction", ["none", "mean"])
@every_case
def test_sequences_give_what_single_transitions_give(case: LossCase, reduction: str) -> None:
    flat = make_batch()
    sequences = flat.reshape(2, 4)
    loss = case.build(reduction=reduction)
    expected = losses_of(evaluate(loss, flat))
    found = losses_of(evaluate(loss, sequences))
    for name, value in expected.items():
        assert found[name].shape == (sequences.shape if reduction == "none" else ())
        torch.testing.assert_close(found[name].reshape(value.shape), value)


@pytest.mark.parametrize("shape", [(8,), (2, 4)])
@every_case
def test_the_batch_stays_as_it_was_but_for_priorities(
    case: LossCase, shape: tuple[int, ...]
) -> None:
    loss, batch = case.build(), make_batch().reshape(shape)
    before, added = batch.clone(), case.writes | case.leaves_behind
    loss(batch)
    assert set(batch.keys(True, True)) - set(before.keys(True, True)) == added
    torch.testing.assert_close(batch.exclude(*added).to_dict(), before.to_dict())
    for key in case.writes:
        assert batch[key].shape == shape and not batch[key].requires_grad
        assert (batch[key] >= 0).all() and (batch[key] > 0).any()


@every_case
def test_losses_alone_carry_gradients(case: LossCase) -> None:
    for name, value in evaluate(case.build(), make_batch()).items():
        assert value.requires_grad == (name in case.losses), name
        assert value.isfinite().all()


@every_case
def test_one_backward_pass_equals_one_per_loss(case: LossCase) -> None:
    together, apart, batch = case.build(), case.build(), make_batch()
    total(evaluate(together, batch)).backward()
    for value in losses_of(evaluate(apart, batch)).values():
        value.backward(retain_graph=True)
    found = gradients(together)
    torch.testing.assert_close(gradients(apart), found)
    assert any(gradient is not None and gradient.abs().sum() > 0 for gradient in found.values())


@pytest.mark.parametrize("case", cases(having="trains"), ids=str)
def test_each_loss_reaches_its_own_parameters_only(case: LossCase) -> None:
    assert set(case.trains) == set(case.losses)
    for name, prefixes in case.trains.items():
        loss = case.build()
        evaluate(loss, make_batch())[name].backward()
        found = {n: gradient for n, gradient in gradients(loss).items() if gradient is not None}
        assert set(found) == {n for n, _ in loss.named_parameters() if n.startswith(prefixes)}
        assert any(gradient.abs().sum() > 0 for gradient in found.values())


@every_case
def test_fresh_actions_are_draws_whatever_the_exploration_type(case: LossCase) -> None:
    loss, batch = case.build(), make_batch()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        one, two = (losses_of(evaluate(loss, batch, seed)) for seed in (0, 1))
    assert any(not torch.equal(one[name], two[name]) for name in one) == case.draws


@pytest.mark.parametrize("case", cases(having="ensemble"), ids=str)
def test_members_together_equal_members_one_by_one(case: LossCase) -> None:
    """Ours are one vectorised network; TorchRL's are mapped over with ``vmap`` or in a loop."""
    batch = make_batch()
    found, expected = (evaluate(case.build(one_by_one=each), batch) for each in (False, True))
    torch.testing.assert_close(found, expected)
