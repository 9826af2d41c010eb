"""What TorchRL asks of its transforms, asked of every transform.

In environments: alone, in a ``Compose``, in and around batches of environments, through partial
resets. Without: as a module, as an inverse, in replay. And: cloned, pickled, saved.
"""

from __future__ import annotations

import inspect
import pickle
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.replay_buffers import SamplerWithoutReplacement
from torchrl.envs import (
    Compose,
    EnvBase,
    InitTracker,
    ParallelEnv,
    RewardSum,
    SerialEnv,
    Transform,
    TransformedEnv,
)
from torchrl.envs.utils import step_mdp
from torchrl.testing import rollout_consistency_assertion

import haim_torchrl

from .transform_cases import CASES, Expectation, TransformCase, works

pytestmark = pytest.mark.filterwarnings("ignore:Nested TransformedEnvs are automatically")
every_case = pytest.mark.parametrize("case", CASES, ids=str)
every_case_for_environments = pytest.mark.parametrize(
    "case", [case for case in CASES if case.inside is works], ids=str
)
fork = partial(ParallelEnv, mp_start_method="fork")


def two(make: Callable[[int], EnvBase]) -> tuple[int, list[Callable[[], EnvBase]]]:
    """Two environments whose episodes end at different times."""
    return 2, [partial(make, 3), partial(make, 5)]


@dataclass(frozen=True)
class Place:
    """Where a transform stands: how to build that, and what is expected there."""

    name: str
    build: Callable[[TransformCase], EnvBase]
    expected: Callable[[TransformCase], Expectation]

    def __str__(self) -> str:
        return self.name


def inside(case: TransformCase) -> Expectation:
    return case.inside


def around(case: TransformCase) -> Expectation:
    return case.around


def composed(case: TransformCase) -> EnvBase:
    return TransformedEnv(case.world(4), Compose(InitTracker(), case.make(), RewardSum()))


def around_serial(case: TransformCase) -> EnvBase:
    return TransformedEnv(SerialEnv(*two(case.world)), case.make())


PLACES = (
    Place("alone", lambda case: case.env(4), inside),
    Place("composed", composed, inside),
    Place("in a SerialEnv", lambda case: SerialEnv(*two(case.env)), inside),
    Place("in a ParallelEnv", lambda case: fork(*two(case.env)), inside),
    Place("around a SerialEnv", around_serial, around),
    Place(
        "around a ParallelEnv",
        lambda case: TransformedEnv(fork(*two(case.world)), case.make()),
        around,
    ),
)


def entries(data: TensorDictBase) -> dict[Any, torch.Tensor]:
    return dict(data.items(True, True))


def assert_same(found: TensorDictBase, expected: TensorDictBase) -> None:
    torch.testing.assert_close(entries(found), entries(expected))


def record(env: EnvBase) -> TensorDictBase:
    """Twelve steps of random actions and several episodes, the same ones each time."""
    env.set_seed(0)
    torch.manual_seed(0)
    return env.rollout(12, break_when_any_done=False)


def test_every_transform_of_the_package_has_a_case() -> None:
    packages = [
        import_module(f"haim_torchrl.{module.name}")
        for module in pkgutil.iter_modules(haim_torchrl.__path__)
    ]
    ours = {
        kind
        for package in packages
        for kind in vars(package).values()
        if inspect.isclass(kind) and issubclass(kind, Transform)
    }
    assert len(ours) >= 4
    assert ours <= {type(case.make()) for case in CASES}


@every_case
@pytest.mark.parametrize("place", PLACES, ids=str)
def test_specs_and_partial_resets(
    case: TransformCase, place: Place, request: pytest.FixtureRequest
) -> None:
    with place.expected(case)():
        env = place.build(case)
        request.addfinalizer(partial(env.close, raise_if_closed=False))
        case.check(env)
        rollout = record(env)
        rollout = rollout.reshape(-1, rollout.shape[-1])
        rollout_consistency_assertion(rollout, done_strict=True)
        for key in case.published:
            before = rollout["next", key][:, :-1]
            ended = rollout["next", "done"][:, :-1]
            carried = torch.where(ended, torch.zeros_like(before), before)
            assert torch.equal(rollout[key][:, 1:], carried), key
            assert not rollout[key][:, 0].any(), key


@every_case_for_environments
def test_writes_what_it_says_and_nothing_else(case: TransformCase) -> None:
    env, bare = case.env(100), case.world(100)
    for each in (env, bare):
        each.set_seed(0)
    torch.manual_seed(0)
    root, bare_root = env.reset(), bare.reset()
    zeros = {key: torch.zeros_like(root[key]) for key in case.published}
    torch.testing.assert_close(entries(root), entries(bare_root) | zeros)
    active = dict.fromkeys(case.published, False)
    for _ in range(12):
        root["action"] = env.action_spec.rand()
        bare_root["action"] = case.executed(root)
        proposed = root["action"].clone()
        step, bare_step = env.step(root), bare.step(bare_root)
        assert torch.equal(step["action"], proposed)
        expected = entries(bare_step["next"])
        expected |= case.written(root, bare_step["next"])
        torch.testing.assert_close(entries(step["next"]), expected)
        active = {key: seen or bool(expected[key].any()) for key, seen in active.items()}
        root, bare_root = step_mdp(step), step_mdp(bare_step)
    assert all(active.values()), active


@every_case_for_environments
def test_around_a_batch_it_does_what_it_does_inside(case: TransformCase) -> None:
    with case.around():
        assert_same(record(around_serial(case)), record(SerialEnv(*two(case.env))))


@every_case_for_environments
def test_a_clone_does_the_same_elsewhere(case: TransformCase) -> None:
    transform = case.make()
    env = TransformedEnv(case.world(4), transform)
    expected = record(env)
    twin = transform.clone()
    assert twin.parent is None
    assert transform.parent is not None
    assert_same(record(env), expected)
    with case.twice():
        assert_same(record(TransformedEnv(case.world(4), twin)), expected)


@every_case_for_environments
def test_pickled_it_does_the_same(case: TransformCase) -> None:
    transform = case.make()
    expected = record(TransformedEnv(case.world(4), transform))
    twin = pickle.loads(pickle.dumps(transform.clone()))
    with case.twice():
        assert_same(record(TransformedEnv(case.world(4), twin)), expected)


@every_case_for_environments
def test_state_of_an_environment_is_saved_and_loaded(case: TransformCase) -> None:
    env, other = case.env(4), case.env(4)
    for seed, each in enumerate((env, other)):
        each.set_seed(seed)
        each.reset()
    state = env.state_dict()
    other.load_state_dict(state)
    torch.testing.assert_close(dict(other.state_dict()), dict(state))
    with case.saved_around():
        batched = around_serial(case)
        batched.load_state_dict(batched.state_dict())


@every_case
def test_state_without_environment(case: TransformCase) -> None:
    for transform in (case.make(), Compose(case.make())):
        transform.load_state_dict(transform.state_dict())


@every_case
def test_as_a_module(case: TransformCase) -> None:
    with case.offline():
        assert_same(case.make()(case.data()), case.forward(case.data()))


@every_case
def test_in_a_compose_without_environment(case: TransformCase) -> None:
    composed = Compose(case.make())
    assert_same(composed.inv(case.data()), case.inverse(case.data()))
    with case.offline():
        assert_same(composed(case.data()), case.forward(case.data()))


@every_case
def test_before_a_model(case: TransformCase) -> None:
    model = TensorDictModule(lambda entry: 2.0 * entry, in_keys=[case.read], out_keys=["doubled"])
    sequence = TensorDictSequential(case.make(), model)
    with case.offline():
        found = sequence(case.data())
        torch.testing.assert_close(found["doubled"], 2.0 * case.forward(case.data())[case.read])


@every_case
def test_inverse_leaves_its_input(case: TransformCase) -> None:
    data = case.data()
    assert_same(case.make().inv(data), case.inverse(case.data()))
    assert_same(data, case.data())


@every_case
def test_in_a_replay_buffer(case: TransformCase) -> None:
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(10),
        sampler=SamplerWithoutReplacement(shuffle=False),
        transform=case.make(),
        batch_size=2,
    )
    buffer.extend(case.data())
    stored = case.inverse(case.data())
    assert_same(buffer.storage[:].exclude("index"), stored)
    with case.offline():
        assert_same(buffer.sample().exclude("index"), case.forward(stored))
