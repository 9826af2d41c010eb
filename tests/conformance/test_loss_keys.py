"""Names of entries: what ``set_keys`` accepts, and that it is honoured."""

from __future__ import annotations

import pytest
import torch
from tensordict import NestedKey, unravel_key
from torchrl.objectives import LossModule

from .loss_case import LossCase, evaluate
from .loss_cases import CASES
from .networks import Rename, make_batch, renamed_entries

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")
every_case = pytest.mark.parametrize("case", CASES, ids=str)


def owner_and_role(loss: LossModule, path: str) -> tuple[LossModule, str]:
    """The module whose key a path names, and the key's role there."""
    owner, _, role = path.rpartition(".")
    return loss.get_submodule(owner), role


def last(key: NestedKey) -> str:
    """Name of an entry without ``next``."""
    return key if isinstance(key, str) else key[-1]


def flat(name: str) -> NestedKey:
    return f"my_{name}"


def nested(name: str) -> NestedKey:
    # TorchRL looks for the weights of prioritised replay at the root only.
    return name if name == "priority_weight" else ("mine", name)


@every_case
def test_unknown_keys_are_refused(case: LossCase) -> None:
    with pytest.raises(ValueError, match="hat_size is not an accepted tensordict key"):
        case.build().set_keys(hat_size="large")


@every_case
def test_accepted_keys_and_their_defaults(case: LossCase) -> None:
    loss = case.build()
    for path, key in case.keys.items():
        owner, role = owner_and_role(loss, path)
        assert getattr(owner.tensor_keys, role) == key, path
    accepted = [
        f"{path}.{role}".lstrip(".")
        for path, module in loss.named_modules()
        if isinstance(module, LossModule)
        for role in module._AcceptedKeys.__dataclass_fields__
    ]
    assert sorted(accepted) == sorted(case.keys)


@every_case
def test_keys_can_be_set_and_set_back(case: LossCase) -> None:
    """Set on the loss itself, as a user does; in a composite this reaches all terms."""
    loss = case.build()
    owners = [owner_and_role(loss, path) for path in case.keys]
    for role in {role for _, role in owners}:
        tensor_keys = [owner.tensor_keys for owner, known in owners if known == role]
        defaults = [getattr(owner.default_keys(), role) for owner, known in owners if known == role]
        loss.set_keys(**{role: "renamed"})
        assert all(getattr(keys, role) == "renamed" for keys in tensor_keys)
        loss.set_keys(**{role: None})
        assert [getattr(keys, role) for keys in tensor_keys] == defaults


@pytest.mark.parametrize("rename", [flat, nested])
@every_case
def test_data_under_other_names_gives_the_same(case: LossCase, rename: Rename) -> None:
    batch = make_batch()
    expected = evaluate(case.build(), batch)
    loss = case.build(rename=rename)
    for path, key in case.keys.items():
        owner, role = owner_and_role(loss, path)
        owner.set_keys(**{role: rename(key)})
    renamed = renamed_entries(batch, rename)
    before = set(renamed.keys(True, True))
    torch.manual_seed(0)
    torch.testing.assert_close(dict(loss(renamed).items()), expected)
    assert set(renamed.keys(True, True)) - before - case.leaves_behind == {
        rename(key) for key in case.writes
    }
    names = {
        rename(key) if isinstance(key, str) else unravel_key(("next", rename(key[-1])))
        for key in case.reads
    }
    assert {unravel_key(key) for key in loss.in_keys} == names


@every_case
def test_keys_set_after_a_call_count_too(case: LossCase) -> None:
    """Of entries that no network reads or writes: nothing of the first call may be left."""
    networks = {"observation", "action", "state_action_value", "state_value", "action_log_prob"}
    networks |= {"action_members", "doubt"}
    changed = {path: key for path, key in case.keys.items() if key not in networks}
    batch, loss = make_batch().set("priority_weight", torch.arange(1.0, 9.0)), case.build()
    expected, before = evaluate(loss, batch), {last(key) for key in loss.in_keys}
    for path, key in changed.items():
        owner, role = owner_and_role(loss, path)
        owner.set_keys(**{role: flat(key)})
    renamed = renamed_entries(batch, lambda key: flat(key) if key in changed.values() else key)
    torch.testing.assert_close(evaluate(loss, renamed), expected)
    expected_names = {flat(key) if key in changed.values() else key for key in before}
    assert {last(key) for key in loss.in_keys} == expected_names


@pytest.mark.parametrize(
    "case", [case for case in CASES if case.checks_critic and case.ensemble], ids=str
)
def test_a_critic_that_reads_another_action_is_named(case: LossCase) -> None:
    loss = case.build(rename=flat)
    with pytest.raises(ValueError, match="my_action"):
        evaluate(loss, renamed_entries(make_batch(), flat))
