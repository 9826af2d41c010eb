"""Target parameters: where they are, and who moves them."""

from __future__ import annotations

import warnings

import pytest
import torch
from tensordict.nn import TensorDictParams
from torchrl.objectives import HardUpdate, LossModule, SoftUpdate

from haim_torchrl.objectives import TargetUpdater

from .loss_case import LossCase, evaluate
from .loss_cases import CASES, cases
from .networks import make_batch

quiet = pytest.mark.filterwarnings("ignore:No target network updater")
WITH_TARGETS = cases(having="targets")
#: TorchRL's updaters look for targets among the direct children of a loss only.
DIRECT = [case for case in WITH_TARGETS if not any("." in name for name in case.targets)]


def online_of(case: LossCase) -> tuple[str, ...]:
    """Names of the parameters that the targets follow, in the order of the targets."""
    return tuple(name.replace("target_", "") for name in case.targets)


def tensors(loss: LossModule, names: tuple[str, ...]) -> list[torch.Tensor]:
    """Copies of all tensors below some modules of a loss."""
    modules = [loss.get_submodule(name) for name in names]
    return [t.detach().clone() for module in modules for t in module.values(True, True)]


def shift_online(loss: LossModule, by: float) -> None:
    """Adds a number to all parameters; targets are no parameters."""
    with torch.no_grad():
        for parameter in loss.parameters():
            parameter.add_(by)


@quiet
@pytest.mark.parametrize("case", CASES, ids=str)
def test_targets_start_as_copies_of_their_own(case: LossCase) -> None:
    loss = case.build()
    found = [
        name
        for name, module in loss.named_modules()
        if isinstance(module, TensorDictParams) and "target_" in name
    ]
    assert sorted(found) == sorted(case.targets)
    before = tensors(loss, case.targets)
    torch.testing.assert_close(before, tensors(loss, online_of(case)))
    shift_online(loss, 1.0)
    torch.testing.assert_close(tensors(loss, case.targets), before)


@pytest.mark.parametrize("case", WITH_TARGETS, ids=str)
def test_nobody_moving_the_targets_is_warned_of(case: LossCase) -> None:
    loss, batch = case.build(), make_batch()
    with pytest.warns(UserWarning, match="No target network updater"):
        evaluate(loss, batch)
    TargetUpdater(loss)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        evaluate(loss, batch)


@quiet
@pytest.mark.parametrize(
    ("case", "kind"),
    [(case, TargetUpdater) for case in WITH_TARGETS] + [(case, SoftUpdate) for case in DIRECT],
    ids=str,
)
def test_soft_updates(case: LossCase, kind: type[SoftUpdate] | type[TargetUpdater]) -> None:
    loss = case.build()
    updater = kind(loss, tau=0.25)
    before = tensors(loss, case.targets)
    shift_online(loss, 4.0)
    for moved in (1.0, 1.75):  # a quarter of the way, then a quarter of the rest
        updater.step()
        torch.testing.assert_close(tensors(loss, case.targets), [t + moved for t in before])


@quiet
@pytest.mark.parametrize("case", DIRECT, ids=str)
def test_hard_updates(case: LossCase) -> None:
    loss = case.build()
    updater = HardUpdate(loss, value_network_update_interval=1)
    before = tensors(loss, case.targets)
    shift_online(loss, 4.0)
    updater.step()
    torch.testing.assert_close(tensors(loss, case.targets), before)
    updater.step()
    torch.testing.assert_close(tensors(loss, case.targets), tensors(loss, online_of(case)))


@quiet
@pytest.mark.parametrize("case", WITH_TARGETS, ids=str)
def test_moved_targets_move_the_loss(case: LossCase) -> None:
    loss, batch = case.build(), make_batch()
    before = evaluate(loss, batch)
    with torch.no_grad():
        for name in case.targets:
            for tensor in loss.get_submodule(name).values(True, True):
                tensor.add_(0.1)
    after = evaluate(loss, batch)
    assert all(not torch.equal(before[name], after[name]) for name in case.discounted)


@pytest.mark.parametrize("case", [case for case in CASES if case not in DIRECT], ids=str)
def test_torchrls_updaters_say_that_they_find_no_targets(case: LossCase) -> None:
    for make in (lambda loss: SoftUpdate(loss, tau=0.1), HardUpdate):
        with pytest.raises(RuntimeError, match="Did not find any target parameters"):
            make(case.build())


@pytest.mark.parametrize("case", [case for case in CASES if not case.targets], ids=str)
def test_our_updater_says_that_there_are_no_targets(case: LossCase) -> None:
    with pytest.raises(ValueError, match="no target parameters"):
        TargetUpdater(case.build())


@quiet
@pytest.mark.parametrize("case", WITH_TARGETS, ids=str)
def test_a_reset_draws_targets_too(case: LossCase) -> None:
    loss = case.build()
    shift_online(loss, 1.0)
    before = tensors(loss, case.targets)
    loss.reset_parameters_recursive()
    after, online = tensors(loss, case.targets), tensors(loss, online_of(case))
    assert not any(torch.equal(a, b) for a, b in zip(after, before))
    assert all(torch.equal(a, b) for a, b in zip(after, online)) == case.reset_copies_targets
