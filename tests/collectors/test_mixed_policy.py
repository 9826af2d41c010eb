import pytest
import torch
from torchrl.collectors import Collector, MultiSyncCollector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import Compose, GymEnv, SerialEnv, StepCounter, TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type

from haim_torchrl.collectors import make_collector, resume_collector
from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.modules import make_actor
from haim_torchrl.switches import ActionSwitch, Always, Hold, Never
from haim_torchrl.transforms import REPLAY_KEYS, InterventionTransform, TakeoverToTransition


@pytest.fixture
def pendulum():
    """Builds a factory of Pendulums; a closure, because workers cannot import tests."""

    def build(switch=None, horizon=7, mentor=1.0):
        def make_mentor():
            return FunctionMentor(lambda simulator, step: [mentor])

        def make_env():
            takeover = InterventionTransform(make_mentor, switch or Hold(ActionSwitch(1.5), 2))
            steps = StepCounter(max_steps=horizon)
            return TransformedEnv(GymEnv("Pendulum-v1"), Compose(steps, takeover))

        return make_env

    return build


@pytest.fixture
def actor(pendulum):
    torch.manual_seed(0)
    return make_actor(3, action_spec=pendulum()().action_spec, hidden=(16,))


def says_who_drove(batch):
    """Holds a batch [..., T] to the table of a transition."""
    flag, following = batch["intervention"], batch["next"]
    executed = torch.where(flag, batch["action_mentor"], batch["action_agent"])
    assert torch.equal(batch["action"], executed)
    assert not batch["action_mentor"][~flag].any()
    assert not following["takeover_cost"][~batch["takeover_start"]].any()
    ended = following["done"][..., :-1, :]
    rises = flag[..., 1:, :] & (~flag[..., :-1, :] | ended)
    assert torch.equal(batch["takeover_start"][..., 1:, :], rises)
    assert "behavior_action" not in batch.keys(True)
    # Pendulum: the speed gained is 15 sin(angle) + 3 torque times 0.05 s, cut at 8 rad/s.
    before, after = batch["observation"], following["observation"]
    sine = before[..., 1:2]
    speed = before[..., 2:] + 0.05 * (15.0 * sine + 3.0 * batch["action"])
    torch.testing.assert_close(after[..., 2:], speed.clamp(-8.0, 8.0), atol=1e-4, rtol=1e-4)


def test_every_transition_says_who_drove(pendulum, actor):
    collector = make_collector(pendulum(), actor, frames_per_batch=50, total_frames=100, seed=0)
    assert isinstance(collector, Collector)
    batches = list(collector)
    assert [batch.batch_size for batch in batches] == [(50,), (50,)]
    everything = torch.cat(batches)
    says_who_drove(everything)
    assert everything["intervention"].any() and not everything["intervention"].all()
    assert "loc" not in everything


def test_several_simulators_in_one_process(pendulum, actor):
    make_env = pendulum()
    collector = make_collector(
        lambda: SerialEnv(2, make_env), actor, frames_per_batch=40, total_frames=40
    )
    (batch,) = collector
    assert batch.batch_size == (2, 20)
    says_who_drove(batch)


def test_worker_processes(pendulum, actor):
    collector = make_collector(
        [pendulum(), pendulum(Always(), mentor=-2.0)],
        actor,
        frames_per_batch=40,
        total_frames=160,
        num_workers=2,
        seed=0,
    )
    try:
        assert isinstance(collector, MultiSyncCollector)
        batches = iter(collector)
        first = next(batches)
        assert first.batch_size == (2, 20)
        says_who_drove(first)
        assert first["intervention"][1].all() and not first["intervention"][0].all()
        assert not torch.equal(first["observation"][0, 0], first["observation"][1, 0])
        with torch.no_grad():  # an update that everybody notices
            actor.module[0].module.layers[-1].bias.copy_(torch.tensor([30.0, -30.0]))
        collector.update_policy_weights_()
        next(batches)  # may have begun before
        assert (next(batches)["action_agent"] > 1.9).all()
        state = collector.state_dict()
        resume_collector(collector, state)
        resumed = next(batches)
        assert resumed["step_count"][:, 0].tolist() == [[0], [0]]
        assert collector.state_dict()["frames"] == 160
    finally:
        collector.shutdown()


def test_training_changes_what_is_collected_next(pendulum, actor):
    batches = iter(make_collector(pendulum(Never()), actor, frames_per_batch=20))
    assert next(batches)["action_agent"].abs().max() < 2.0
    with torch.no_grad():
        actor.module[0].module.layers[-1].bias.copy_(torch.tensor([30.0, -30.0]))
    assert (next(batches)["action_agent"] > 1.9).all()


def test_updating_the_weights_is_harmless_in_one_process(pendulum, actor):
    collector = make_collector(pendulum(), actor, frames_per_batch=20)
    before = [parameter.clone() for parameter in actor.parameters()]
    next(iter(collector))
    collector.update_policy_weights_()
    assert all(torch.equal(a, b) for a, b in zip(before, actor.parameters()))


def test_random_frames_are_protected_too(pendulum, actor):
    with torch.no_grad():
        actor.module[0].module.layers[-1].bias.copy_(torch.tensor([30.0, -30.0]))
    collector = make_collector(
        pendulum(Hold(ActionSwitch(1.5), 1)),
        actor,
        frames_per_batch=50,
        total_frames=100,
        init_random_frames=50,
    )
    random, learned = collector
    for batch in (random, learned):
        says_who_drove(batch)
        apart = (batch["action_agent"] - 1.0).abs() > 1.5
        assert torch.equal(batch["intervention"], apart)
    assert random["action_agent"].std() > 0.8
    assert random["intervention"].any()
    assert (learned["action_agent"] > 1.9).all()


def test_the_agent_explores_whatever_is_set_around_it(pendulum, actor):
    def proposals(**options):
        collector = make_collector(pendulum(Never()), actor, frames_per_batch=20, **options)
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            batch = next(iter(collector))
            with torch.no_grad():
                mean = actor(batch.select("observation"))["action"]
        return (batch["action_agent"] - mean).abs()

    assert (proposals() > 1e-6).all()
    assert (proposals(exploration_type=ExplorationType.DETERMINISTIC) < 1e-6).all()


@pytest.mark.parametrize("seeds", [(3, 3), (3, 4)])
def test_the_same_seed_twice_is_the_same_run(pendulum, actor, seeds):
    runs = []
    for seed in seeds:
        torch.manual_seed(0)
        collector = make_collector(
            pendulum(), actor, frames_per_batch=30, total_frames=60, seed=seed
        )
        runs.append(torch.cat(list(collector)))
    same = torch.equal(runs[0]["observation"], runs[1]["observation"])
    assert same is (seeds[0] == seeds[1])


def test_a_resumed_run_goes_on_as_the_saved_one(pendulum, actor):
    def collect(seed):
        return make_collector(pendulum(), actor, frames_per_batch=25, total_frames=75, seed=seed)

    torch.manual_seed(0)
    saved = collect(0)
    batches = iter(saved)
    next(batches)
    state = saved.state_dict()
    saved.reset()
    torch.manual_seed(1)
    expected = next(batches)

    resumed = collect(5)
    resume_collector(resumed, state)
    torch.manual_seed(1)
    batch = next(iter(resumed))
    for key in ("observation", "action", "intervention", "takeover_start"):
        assert torch.equal(batch[key], expected[key]), key
    assert len(list(resumed)) == 1  # 25 of 75 steps were done before, 25 just now


def test_straight_into_a_replay_buffer(pendulum, actor):
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100), batch_size=10, transform=TakeoverToTransition(REPLAY_KEYS)
    )
    collector = make_collector(
        pendulum(), actor, frames_per_batch=30, total_frames=60, replay_buffer=buffer
    )
    for _ in collector:
        pass
    assert len(buffer) == 60
    stored = buffer[:]
    assert torch.equal(
        stored["action"],
        torch.where(stored["intervention"], stored["action_mentor"], stored["action_agent"]),
    )


def test_environments_without_takeovers_are_refused(actor):
    collector = make_collector(lambda: GymEnv("Pendulum-v1"), actor, frames_per_batch=10)
    with pytest.raises(KeyError, match="do not say who drove"):
        next(iter(collector))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames_per_batch": 0}, "frames_per_batch is 0"),
        ({"frames_per_batch": 5, "num_workers": 2}, "multiple of the 2 environments"),
        ({"frames_per_batch": 5, "num_workers": -1}, "num_workers is -1"),
        (
            {"frames_per_batch": 5, "total_frames": 10, "init_random_frames": 20},
            "the agent would never act",
        ),
    ],
)
def test_numbers_that_do_not_fit(pendulum, actor, options, message):
    with pytest.raises(ValueError, match=message):
        make_collector(pendulum(), actor, **options)


def test_one_factory_for_each_worker(pendulum, actor):
    with pytest.raises(ValueError, match="3 environment factories for 2"):
        make_collector([pendulum()] * 3, actor, frames_per_batch=4, num_workers=2)
