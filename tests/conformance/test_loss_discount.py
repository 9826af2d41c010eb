"""Bootstrapped targets: the value estimator, the end of an episode, several steps at once."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import MultiStep
from torchrl.objectives import LossModule, ValueEstimators

from .loss_case import LossCase, evaluate
from .loss_cases import cases
from .networks import ACTION, OBSERVATION, make_batch

pytestmark = pytest.mark.filterwarnings("ignore:No target network updater")
discounted_cases = pytest.mark.parametrize("case", cases(having="discounted"), ids=str)


def bootstrapped(
    case: LossCase, loss: LossModule, batch: TensorDict, seed: int = 0
) -> dict[str, torch.Tensor]:
    """The losses that bootstrap."""
    result = evaluate(loss, batch, seed)
    return {name: result[name] for name in case.discounted}


def with_other_future(batch: TensorDict) -> TensorDict:
    """The same transitions, leading elsewhere."""
    return batch.clone().set(("next", "observation"), -batch["next", "observation"])


def with_ends(batch: TensorDict, *, terminated: bool, truncated: bool) -> TensorDict:
    """All transitions ending as said."""
    ends = {"terminated": terminated, "truncated": truncated, "done": terminated or truncated}
    batch = batch.clone()
    for name, value in ends.items():
        batch["next", name].fill_(value)
    return batch


@discounted_cases
def test_default_discount(case: LossCase) -> None:
    batch = make_batch()
    default, explicit = case.build(), case.build()
    explicit.make_value_estimator(ValueEstimators.TD0, gamma=0.99)
    torch.testing.assert_close(
        bootstrapped(case, default, batch), bootstrapped(case, explicit, batch)
    )
    default.make_value_estimator()
    torch.testing.assert_close(
        bootstrapped(case, default, batch), bootstrapped(case, explicit, batch)
    )


@discounted_cases
def test_without_discounting_the_future_it_counts(case: LossCase) -> None:
    """With gamma = 0 the next state does not matter, with any other gamma it does."""
    batch = make_batch()
    for gamma in (0.0, 0.5):
        loss = case.build()
        loss.make_value_estimator(gamma=gamma)
        here = bootstrapped(case, loss, batch)
        elsewhere = bootstrapped(case, loss, with_other_future(batch))
        for name, value in here.items():
            assert torch.equal(value, elsewhere[name]) == (gamma == 0.0)


@discounted_cases
def test_unsupported_estimators_are_refused(case: LossCase) -> None:
    for kind in case.unsupported:
        with pytest.raises(NotImplementedError):
            case.build().make_value_estimator(kind)


@discounted_cases
def test_unknown_and_senseless_hyperparameters_are_refused(case: LossCase) -> None:
    with pytest.raises(TypeError, match="hat_size"):
        case.build().make_value_estimator(ValueEstimators.TD0, hat_size=3)
    for gamma in case.refused_gammas:
        with pytest.raises(ValueError, match=r"\[0, 1\]"):
            case.build().make_value_estimator(gamma=gamma)


@discounted_cases
def test_nothing_comes_after_a_terminated_state(case: LossCase) -> None:
    loss, batch = case.build(), with_ends(make_batch(), terminated=True, truncated=False)
    here = bootstrapped(case, loss, batch)
    torch.testing.assert_close(bootstrapped(case, loss, with_other_future(batch)), here)
    # A fresh action at the next state changes nothing, either.
    torch.testing.assert_close(bootstrapped(case, loss, batch, seed=1), here)


@discounted_cases
def test_an_episode_cut_off_goes_on(case: LossCase) -> None:
    loss = case.build()
    cut = with_ends(make_batch(), terminated=False, truncated=True)
    going_on = with_ends(make_batch(), terminated=False, truncated=False)
    torch.testing.assert_close(bootstrapped(case, loss, cut), bootstrapped(case, loss, going_on))


def four_steps() -> TensorDict:
    """One trajectory ``[1, 4]`` without takeovers, with signals 1, 2, 4, 8, then cut off."""
    signal = torch.tensor([1.0, 2.0, 4.0, 8.0]).reshape(1, 4, 1)
    no, last = torch.zeros(1, 4, 1, dtype=torch.bool), signal == 8.0
    action = torch.zeros(1, 4, ACTION)
    root = {"action": action, "action_agent": action, "action_mentor": action}
    flags = {"intervention": no, "takeover_start": no}
    signals = {name: signal.clone() for name in SIGNALS}
    ends = {"terminated": no, "truncated": last, "done": last}
    observation = torch.randn(1, 5, OBSERVATION)
    future = {"observation": observation[:, 1:], **signals, **ends}
    data = {"observation": observation[:, :-1], **root, **flags, "next": future}
    return TensorDict(data, batch_size=[1, 4])


SIGNALS = ("reward", "cost", "takeover_cost", "disturbance_cost")
#: Steps until the trajectory is cut off or three are taken, and the signals on the way.
STEPS, SUMS = (3, 3, 2, 1), (1 + 2 / 2 + 4 / 4, 2 + 4 / 2 + 8 / 4, 4 + 8 / 2, 8.0)


@discounted_cases
def test_several_steps_are_discounted_several_times(case: LossCase) -> None:
    """TorchRL's ``MultiStep`` with gamma = 1/2, Q = 0 everywhere and Q' = 16 everywhere."""
    several = MultiStep(gamma=0.5, n_steps=3)
    several.reward_keys = SIGNALS
    batch = several(four_steps())
    assert tuple(batch["steps_to_next_obs"].flatten().tolist()) == STEPS
    loss = case.build(reduction="none", alpha=1e-30)
    loss.make_value_estimator(gamma=0.5)
    for name in case.targets:
        for params, value in ((name, 16.0), (name.replace("target_", ""), 0.0)):
            for key, parameter in loss.get_submodule(params).items(True, True):
                is_bias = "bias" in (key if isinstance(key, str) else ".".join(key))
                parameter.data.fill_(value if is_bias else 0.0)
    result = bootstrapped(case, loss, batch)
    for name, fact in case.discounted.items():
        sums = SUMS if fact.signal else (0.0,) * 4
        targets = [s + 0.5**n * 16.0 for s, n in zip(sums, STEPS)]
        expected = fact.scale * torch.tensor([targets]) ** 2
        torch.testing.assert_close(result[name], expected)
    assert all(batch.shape == result[name].shape for name in case.discounted)
