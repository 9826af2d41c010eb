"""Collection by workers of a Ray that is started here, for these tests together."""

import importlib.util
from types import SimpleNamespace

import pytest
import torch
from torchrl.collectors.distributed import RayCollector
from torchrl.envs import Compose, GymEnv, StepCounter, TransformedEnv

from haim_torchrl.collectors import (
    ClusterError,
    cluster,
    make_collector,
    make_ray_collector,
    resume_collector,
)
from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.modules import make_actor
from haim_torchrl.switches import ActionSwitch, Hold
from haim_torchrl.transforms import InterventionTransform

needs_ray = pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is an extra")


@pytest.fixture(scope="module")
def ray_here():
    """A Ray of two CPUs, which collectors join; they start one themselves in the recipe's test."""
    import ray

    ray.init(**{**cluster.own_ray(2), "num_cpus": 2})
    yield ray
    ray.shutdown()


def pendulum(broken=False):
    """Builds a factory of Pendulums; a closure, because workers cannot import tests."""

    def make_mentor():
        return FunctionMentor(lambda simulator, step: [1.0])

    def make_env():
        if broken:
            raise ValueError("the pendulum\nhas no bob")
        takeover = InterventionTransform(make_mentor, Hold(ActionSwitch(1.5), 2))
        steps = StepCounter(max_steps=7)
        return TransformedEnv(GymEnv("Pendulum-v1"), Compose(steps, takeover))

    return make_env


@pytest.fixture
def actor():
    torch.manual_seed(0)
    return make_actor(3, action_spec=pendulum()().action_spec, hidden=(16,))


def same(one, other):
    names = set(one.keys(True, True)) - {("collector", "traj_ids")}
    assert names == set(other.keys(True, True))
    for key in names:
        assert torch.equal(one[key], other[key]), key


@needs_ray
def test_a_collector_in_two_processes_of_ray(ray_here, actor):
    settings = {"frames_per_batch": 40, "num_workers": 2, "seed": 3}
    here = make_collector(pendulum(), actor, total_frames=80, **settings)
    try:
        expected = [batch.clone() for batch in here]
    finally:
        here.shutdown()
    assert expected[0]["intervention"].any() and not expected[0]["intervention"].all()

    collector = make_ray_collector(pendulum(), actor, total_frames=240, **settings)
    try:
        # The same seeds are the same data, wherever the processes run.
        assert isinstance(collector, RayCollector)
        batches = iter(collector)
        for batch in expected:
            collected = next(batches)
            assert collected.batch_size == (2, 20)
            same(batch, collected)

        # A saved and resumed run goes on as the saved one.
        saved = collector.state_dict()
        collector.reset()
        following = next(batches).clone()
        assert following["step_count"][:, 0].tolist() == [[0], [0]]
        resume_collector(collector, saved)
        same(following, next(batches))
        assert collector.state_dict()["frames"] == 120
        with pytest.raises(ClusterError, match=r"saved with 1 Ray workers .* use .*num_workers=1"):
            collector.load_state_dict({"frames": 0, "workers": saved["workers"][:1]})

        # An update reaches both workers, and nothing is collected with the weights before it.
        with torch.no_grad():
            actor.module[0].module.layers[-1].bias.copy_(torch.tensor([30.0, -30.0]))
        collector.update_policy_weights_()
        assert (next(batches)["action_agent"] > 1.9).all()

        # A machine that is lost is said, in a sentence.
        ray_here.kill(collector.remote_collectors[1])
        with pytest.raises(ClusterError, match=r"^a Ray worker failed: [^\n]+$"):
            next(batches)
    finally:
        collector.shutdown()
    assert ray_here.is_initialized()  # it was not the collector that started it


@needs_ray
def test_a_worker_that_cannot_build_its_environment(ray_here, actor):
    with pytest.raises(ClusterError, match=r"^a Ray worker failed: .*the pendulum has no bob$"):
        make_ray_collector(pendulum(broken=True), actor, frames_per_batch=4, num_workers=1)


@needs_ray
def test_a_cluster_that_is_too_small(ray_here, actor):
    with pytest.raises(ClusterError, match=r"has 2 CPUs and collector.num_workers .* asks for 3"):
        make_ray_collector(pendulum(), actor, frames_per_batch=6, num_workers=3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_workers": 0}, "num_workers is 0"),
        ({"cpus_per_worker": 0.0}, "cpus_per_worker is 0.0"),
        ({"frames_per_batch": 5}, "multiple of the 2 environments"),
    ],
)
def test_numbers_that_do_not_fit(monkeypatch, actor, options, message):
    monkeypatch.setattr(cluster, "find_spec", lambda name: SimpleNamespace())
    with pytest.raises(ValueError, match=message):
        make_ray_collector(pendulum(), actor, **{"frames_per_batch": 4, **options})


def test_without_ray_the_package_is_named(monkeypatch, actor):
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    with pytest.raises(ClusterError, match=r"pip install \"haim-torchrl\[ray\]\""):
        make_ray_collector(pendulum(), actor, frames_per_batch=4)
