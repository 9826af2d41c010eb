import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import (
    ActionScaling,
    Compose,
    EnvBase,
    GymEnv,
    RenameTransform,
    SerialEnv,
    StepCounter,
    TransformedEnv,
)
from torchrl.envs.utils import step_mdp

from haim_torchrl.mentors import FunctionMentor
from haim_torchrl.switches import ActionSwitch, Always, Hold, Never
from haim_torchrl.transforms import (
    InterventionKeys,
    InterventionTransform,
    check_intervention_specs,
)


def constant(value):
    return lambda: FunctionMentor(lambda simulator, step: [value])


def torque_that_moved(before, after):
    """The torque that turned one pendulum state into the next (gymnasium's equation of motion)."""
    angle = torch.atan2(before[..., 1], before[..., 0])
    gained = (after[..., 2] - before[..., 2]) / 0.05
    return (gained - 15.0 * torch.sin(angle)) / 3.0


def test_decides_first_and_steps_once(pendulum, scripted_switch):
    env = pendulum(scripted_switch([0, 1, 1, 0]), mentor=constant(0.5))
    env.set_seed(0)
    rollout = env.rollout(12)
    executed = rollout["next", "behavior_action"].squeeze(-1)
    torque = torque_that_moved(rollout["observation"], rollout["next", "observation"])
    torch.testing.assert_close(torque, executed, atol=1e-3, rtol=1e-3)
    mentor_drives = torch.tensor([False, True, True, False] * 3)
    assert torch.equal(rollout["next", "intervention"].squeeze(-1), mentor_drives)
    assert (executed[mentor_drives] == 0.5).all()
    assert torch.equal(executed[~mentor_drives], rollout["action"].squeeze(-1)[~mentor_drives])


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    patterns=st.tuples(*[st.lists(st.booleans(), min_size=1, max_size=7)] * 2),
    horizons=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    steps=st.integers(1, 16),
)
def test_promises_hold_under_partial_resets(pendulum, scripted_switch, patterns, horizons, steps):
    switches = [scripted_switch(pattern) for pattern in patterns]
    env = SerialEnv(
        2,
        [
            lambda: pendulum(switches[0], horizons[0]),
            lambda: pendulum(switches[1], horizons[1]),
        ],
    )
    rollout = env.rollout(steps, break_when_any_done=False)
    following = rollout["next"]
    for row, (pattern, horizon) in enumerate(zip(patterns, horizons)):
        flags = [bool(pattern[t % len(pattern)]) for t in range(steps)]
        before = [t % horizon != 0 and flags[t - 1] for t in range(steps)]
        assert following["intervention"][row].squeeze(-1).tolist() == flags
        assert rollout["intervention"][row].squeeze(-1).tolist() == before
        starts = [now and not then for now, then in zip(flags, before)]
        assert following["takeover_start"][row].squeeze(-1).tolist() == starts
    flag, mentor = following["intervention"], following["action_mentor"]
    agent = following["action_agent"]
    assert torch.equal(following["behavior_action"], torch.where(flag, mentor, agent))
    assert torch.equal(agent, rollout["action"])
    assert not mentor[~flag].any()
    assert (mentor[flag].abs() == 2.0).all()
    assert not following["takeover_cost"][~following["takeover_start"]].any()


def test_takeover_begins_anew_after_a_reset(pendulum):
    rollout = pendulum(Always(), horizon=3).rollout(7, break_when_any_done=False)
    starts = rollout["next", "takeover_start"].squeeze(-1).tolist()
    assert starts == [True, False, False, True, False, False, True]


def test_switch_and_mentor_are_reset_with_the_episode(pendulum, scripted_switch):
    class Counting:
        resets = 0

        def reset(self, simulator):
            assert simulator.state is not None
            self.resets += 1

        def act(self, simulator, tensordict):
            return torch.zeros(1)

    env = pendulum(scripted_switch([0]), horizon=2, mentor=Counting)
    env.rollout(5, break_when_any_done=False)
    transform = env.transform[1]
    assert transform.switch.resets == transform.mentor.resets == 3


def test_mentor_is_asked_only_when_needed(pendulum, scripted_switch):
    asked = []

    def make():
        return FunctionMentor(lambda simulator, step: asked.append(1) or [0.0])

    pendulum(Never(), mentor=make).rollout(5)
    assert len(asked) == 0
    pendulum(scripted_switch([0, 1, 0, 0, 1]), mentor=make).rollout(5)
    assert len(asked) == 2
    pendulum(ActionSwitch(0.1), mentor=make).rollout(5)
    assert len(asked) == 7


def test_mentor_sees_the_step(pendulum):
    seen = []

    def make():
        return FunctionMentor(lambda simulator, step: seen.append(step["observation"]) or [0.0])

    rollout = pendulum(Always(), mentor=make).rollout(4)
    assert torch.equal(torch.stack(seen), rollout["observation"])


@pytest.mark.parametrize(
    ("cost", "mentor", "expected"),
    [
        ("cosine", 2.0, 0.0),  # same direction
        ("cosine", -2.0, 2.0),  # opposite
        ("cosine", 0.0, 0.0),  # no direction
        ("constant", 2.0, 1.0),
        (lambda agent, mentor, start: (agent - mentor).abs(), -2.0, 3.0),
    ],
)
def test_takeover_cost_on_the_first_step_only(pendulum, cost, mentor, expected):
    env = pendulum(Always(), mentor=constant(mentor), cost=cost)
    step, costs = env.reset(), []
    for _ in range(3):
        step = env.step(step.set("action", torch.tensor([1.0])))
        costs.append(step["next", "takeover_cost"].item())
        step = step_mdp(step)
    assert costs == pytest.approx([expected, 0.0, 0.0], abs=1e-6)


def test_agent_and_mentor_share_scaled_units(pendulum):
    env = pendulum(Always(), mentor=constant(0.25), before=[ActionScaling()])
    assert env.action_spec.space.high.item() == 1.0
    env.set_seed(0)
    rollout = env.rollout(5)
    torque = torque_that_moved(rollout["observation"], rollout["next", "observation"])
    torch.testing.assert_close(torque, torch.full((5,), 0.5), atol=1e-3, rtol=1e-3)
    assert (rollout["next", "behavior_action"] == 0.25).all()


def test_renamed_keys():
    keys = InterventionKeys(
        action=("drive", "action"),
        intervention=("drive", "taken"),
        takeover_cost="cost_of_takeover",
    )
    nest_action = RenameTransform(
        in_keys=[], out_keys=[], in_keys_inv=["action"], out_keys_inv=[("drive", "action")]
    )
    takeover = InterventionTransform(constant(0.5), ActionSwitch(0.5), keys=keys)
    env = TransformedEnv(GymEnv("Pendulum-v1"), Compose(nest_action, takeover))
    check_intervention_specs(env, keys=keys)
    assert env.rollout(3)["next", "drive", "taken"].dtype == torch.bool


def test_environments_in_torch_are_simulators_too():
    seen = []

    def make():
        return FunctionMentor(lambda simulator, step: seen.append(simulator) or [0.0])

    base = Counter()
    env = TransformedEnv(base, InterventionTransform(make, Always()))
    check_intervention_specs(env)
    assert seen[0] is base


class Counter(EnvBase):
    """The smallest environment that is not a gym one."""

    def __init__(self, batch_size=()):
        super().__init__(batch_size=batch_size)
        shape = (*batch_size, 1)
        self.observation_spec = Composite(
            observation=Unbounded(shape=shape), shape=torch.Size(batch_size)
        )
        self.action_spec = Bounded(-1.0, 1.0, shape=shape)
        self.reward_spec = Unbounded(shape=shape)
        self.count = 0

    def _reset(self, tensordict=None, **kwargs):
        self.count = 0
        return TensorDict(observation=torch.zeros(1), done=torch.zeros(1, dtype=torch.bool))

    def _step(self, tensordict):
        self.count += 1
        return TensorDict(
            observation=torch.tensor([float(self.count)]),
            reward=torch.zeros(1),
            done=torch.zeros(1, dtype=torch.bool),
        )

    def _set_seed(self, seed): ...


def test_each_environment_has_its_own_switch(pendulum):
    shared = Hold(Always(), 3)
    first, second = pendulum(shared), pendulum(shared)
    assert first.transform[0].switch is not shared
    assert first.transform[0].switch is not second.transform[0].switch


def zero(simulator, step):
    return [0.0]


def test_wrapping_a_transformed_environment_keeps_working(pendulum):
    env = TransformedEnv(pendulum(Always()), StepCounter(4), auto_unwrap=True)
    check_intervention_specs(env)
    nested = TransformedEnv(pendulum(Always()), StepCounter(4), auto_unwrap=False)
    check_intervention_specs(nested)


def test_around_a_batched_simulator_it_says_where_to_go():
    env = Counter([3])
    with pytest.raises(RuntimeError, match="put the transform inside"):
        TransformedEnv(env, InterventionTransform(constant(0.0), Always()))
    inside = TransformedEnv(env, Compose(InterventionTransform(constant(0.0), Always())))
    with pytest.raises(RuntimeError, match="put the transform inside"):
        check_intervention_specs(inside)


def test_step_without_flag_is_refused(pendulum):
    env = pendulum(Always())
    env.reset()
    with pytest.raises(KeyError, match="unknown whether a takeover begins"):
        env.step(TensorDict(action=torch.zeros(1)))


def test_wrong_action_key_is_named():
    env = TransformedEnv(
        GymEnv("Pendulum-v1"),
        InterventionTransform(constant(0.0), Always(), keys=InterventionKeys(action="steer")),
    )
    with pytest.raises(KeyError, match=r"no action 'steer'.*action"):
        env.rollout(1)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0.0, 0.0], "shape"),
        ([float("nan")], "nan"),
        ([2.5], "outside"),
    ],
)
def test_wrong_mentor_actions_stay_out_of_the_data(pendulum, action, message):
    env = pendulum(Always(), mentor=lambda: FunctionMentor(lambda simulator, step: action))
    with pytest.raises(ValueError, match=message):
        env.rollout(1)


def test_rounding_at_the_bounds_is_cut(pendulum):
    rollout = pendulum(Always(), mentor=constant(2.000001)).rollout(1)
    assert rollout["next", "action_mentor"].item() == 2.0


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((FunctionMentor(zero), Always()), TypeError, "builds the mentor"),
        ((constant(0.0), 3), TypeError, "switch is int"),
        ((constant(0.0), lambda: 3), TypeError, "switch is int"),
    ],
)
def test_bad_parts(arguments, error, message):
    with pytest.raises(error, match=message):
        InterventionTransform(*arguments)


def test_bad_cost():
    with pytest.raises(ValueError, match="choose one of"):
        InterventionTransform(constant(0.0), Always(), cost="angle")


def test_factory_of_something_else(pendulum):
    with pytest.raises(TypeError, match="built int, which lacks"):
        pendulum(Always(), mentor=lambda: 3).rollout(1)
