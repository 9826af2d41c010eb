"""Real time around the real environment: what a person is shown is what happened.

The console is played; everything behind it is real.
"""

from __future__ import annotations

import multiprocessing
import pickle
import threading
import time

import pytest
import torch
from torchrl.envs import Compose, GymEnv, TransformedEnv, check_env_specs

from haim_torchrl.envs import make_env
from haim_torchrl.human import Brake, Cockpit, Controls, HumanMentor, PersonQuit, Reading
from haim_torchrl.human.window import WindowConsole
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import Hold, RequestSwitch, RiskSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform

HERE, AWAY = Reading(connected=True), Reading(connected=False, trouble="plug it in")
GAS = Reading(Controls(throttle=1.0, steering=0.02), connected=True, latency_ms=4.0)


def world(cockpit, console=None, fallback=None, **settings):
    """The platoon's world, in which the person at the console may take over."""

    def mentor():
        return HumanMentor(console, fallback, settle=0.02)

    base = make_env(**{"horizon": 30, "observation": {"rays": 24}, **settings})
    takeover = [] if console is None else [InterventionTransform(mentor, RequestSwitch())]
    env = TransformedEnv(base, Compose(*takeover, DisturbanceTransform(), cockpit))
    env.set_seed(0)
    torch.manual_seed(0)
    return env


def careless(tensordict):
    wish = torch.tensor([0.3, 0.0]) + torch.tensor([0.6, 0.05]) * torch.randn(2)
    return tensordict.set("action", wish.clamp(-1.0, 1.0))


def rollout(env, steps):
    return env.rollout(steps, careless, break_when_any_done=False)


def column(driven, key):
    return driven["next", key].squeeze(-1)


def test_the_specs_say_what_is_published(console):
    env = world(Cockpit(500.0), console)
    check_env_specs(env)
    assert env.observation_spec["step_time"].shape == (1,)
    assert env.observation_spec["device_ok"].dtype == torch.bool
    start = env.reset()
    assert not start["step_time"].any() and not start["device_ok"].any()
    env.close()
    assert console.closed >= 1


def test_nobody_at_all_just_keeps_the_pace():
    env = world(Cockpit(100.0), horizon=20)
    driven = rollout(env, 50)
    times = column(driven, "step_time")
    assert (times == 0.0).nonzero().squeeze(-1).tolist() == [0, 20, 40]  # where episodes begin
    assert times[times > 0.0].min() >= 0.9 * 0.01 - 1e-4  # the grid allows a tenth
    assert times[1:20].sum() >= 19 * 0.01 - 1e-3
    assert column(driven, "device_ok").all()
    check_env_specs(env)
    env.close()


def test_as_fast_as_it_goes_measures_nothing(console):
    env = world(Cockpit(None), console)
    assert "step_time" not in env.observation_spec and "step_time" not in rollout(env, 5)["next"]
    env.close()


# What is shown.
def test_frames_say_what_the_transitions_say(console_class):
    def person(console):
        step = console.frames[-1].step
        return GAS if 3 <= step < 9 or 30 <= step < 33 or 60 <= step < 62 else HERE

    console = console_class(person)
    env = world(
        Cockpit(None, total_steps=500, steps_before=100),
        console,
        end_on_collision=False,
        horizon=120,
        scenario={"blocks": {"straight": 1.0}, "obstacles": [0.0, 0.0, 1.0]},
    )
    steps = 400
    driven = rollout(env, steps)
    env.close()
    shown = [frame for frame in console.frames if frame.step > 0]
    assert len(shown) == steps
    after, counts = driven["next"], {"cost": 0.0, "takeover_start": 0, "done": 0, "success": 0}
    episode, step, mentor_steps = 0, 0, 0
    for k, frame in enumerate(shown):
        row = after[k]
        step += 1
        assert (frame.episode, frame.step) == (episode, step)
        intervened = bool(row["intervention"])
        mentor_steps += intervened
        assert frame.driver == ("person" if intervened else "agent")
        assert frame.takeover is intervened
        assert list(frame.action) == row["behavior_action"].tolist()
        assert list(frame.action_agent) == row["action_agent"].tolist()
        assert list(frame.action_mentor) == row["action_mentor"].tolist()
        assert frame.disturbance is bool(row["disturbance"])
        assert frame.cost == float(row["cost"])
        assert frame.takeover_cost == float(row["takeover_cost"])
        assert frame.disturbance_cost == float(row["disturbance_cost"])
        assert frame.device_ok and frame.notice is None
        assert frame.snapshot.speed == pytest.approx(float(row["speed"]), abs=1e-5)
        assert frame.snapshot.follower_gaps == pytest.approx(row["follower_gaps"].numpy(), abs=1e-4)
        assert frame.snapshot.time == pytest.approx(0.1 * step)
        for key in counts:
            counts[key] += float(row[key])
        figures = frame.figures
        assert (figures.steps, figures.total_steps) == (101 + k, 500)
        assert figures.seconds_left is None  # nobody holds a pace
        assert figures.episodes == counts["done"] and figures.successes == counts["success"]
        assert figures.violations == counts["cost"]
        assert figures.takeovers == counts["takeover_start"]
        assert figures.takeover_rate == pytest.approx(mentor_steps / (k + 1))
        if bool(row["done"]):
            episode, step = episode + 1, 0
    # All of it happened, or the comparison would have been one of zeros.
    assert counts["takeover_start"] >= 8 and counts["done"] >= 2 and counts["cost"] > 0.0
    assert sum(frame.disturbance for frame in shown) > 0
    assert {frame.latency_ms for frame in shown} == {None, 4.0}


def test_an_episode_begins_with_its_scene(console):
    env = world(Cockpit(None), console)
    rollout(env, 65)
    first = [frame for frame in console.frames if frame.step == 0]
    assert [scene.episode for scene in console.scenes] == [frame.episode for frame in first]
    assert [scene.episode for scene in console.scenes] == [0, 1, 2]
    assert all(frame.snapshot.time == 0.0 for frame in first)
    assert console.scenes[-1].labels == env.base_env.unwrapped.scenario_labels()
    assert any(line.edge for line in console.scenes[-1].road)
    env.close()


def test_what_is_left_at_the_pace(console):
    env = world(Cockpit(100.0, total_steps=50), console)
    rollout(env, 3)
    left = [frame.figures.seconds_left for frame in console.frames[1:]]
    assert left == pytest.approx([0.49, 0.48, 0.47])
    env.close()


def test_a_fallback_is_told_apart_from_a_person(console_class):
    def person(console):
        step = console.frames[-1].step
        return AWAY if 4 <= step < 8 else GAS if 8 <= step < 10 else HERE

    console = console_class(person)
    env = world(Cockpit(None), console, Brake())
    driven = rollout(env, 12)
    env.close()
    ok = [True] * 4 + [False] * 4 + [True] * 4
    assert column(driven, "device_ok").tolist() == ok
    shown = console.frames[1:]
    assert [frame.device_ok for frame in shown] == ok
    assert [frame.driver for frame in shown[:10]] == (
        ["agent"] * 4 + ["fallback"] * 4 + ["person"] * 2
    )
    assert column(driven, "takeover_start").nonzero().squeeze(-1).tolist() == [4]


# Nothing moves.
def test_a_pause_is_waited_out_and_shown_once(console_class):
    pauses = {5: 4, 12: 3}  # looks at a paused person, by step

    def person(console):
        step = console.frames[-1].step
        if pauses.get(step):
            pauses[step] -= 1
            return Reading(connected=True, paused=True)
        return HERE

    console = console_class(person)
    env = world(Cockpit(200.0), console)
    began = time.monotonic()
    driven = rollout(env, 16)
    assert time.monotonic() - began >= 7 * 0.03
    env.close()
    notices = [(frame.step, frame.notice) for frame in console.frames if frame.notice]
    assert notices == [(5, "paused"), (12, "paused")]
    # What follows a pause is no step that lasted that long.
    times = column(driven, "step_time")
    assert (times == 0.0).nonzero().squeeze(-1).tolist() == [0, 5, 12]
    assert len([frame for frame in console.frames if frame.step > 0 and not frame.notice]) == 16


def test_a_lost_device_is_waited_for_and_each_reason_shown(console_class):
    looks = iter([AWAY] * 3)

    def person(console):
        return next(looks, HERE) if console.frames[-1].step == 2 else HERE

    console = console_class(person)
    env = world(Cockpit(200.0), console)
    driven = rollout(env, 5)
    env.close()
    notices = [(f.step, f.notice, f.device_ok) for f in console.frames if f.notice]
    assert notices == [(2, "plug it in", False), (2, "the driver is back", True)]
    assert (column(driven, "step_time") == 0.0).nonzero().squeeze(-1).tolist() == [0, 2]
    assert column(driven, "device_ok").all()  # nothing was driven without one
    assert not column(driven, "intervention").any()


@pytest.mark.parametrize("paused", [False, True])
def test_who_wants_to_stop_stops_the_run(console_class, paused):
    def person(console):
        quitting = console.frames[-1].step == 2
        return Reading(connected=True, quit=quitting, paused=paused and quitting)

    console = console_class(person)
    env = world(Cockpit(None), console)
    with pytest.raises(PersonQuit):
        rollout(env, 10)
    assert console.frames[-1].step == 2
    env.close()
    assert console.closed >= 1


# A process that only drives.
def test_it_waits_for_the_learner_when_all_is_driven(console):
    stop = multiprocessing.get_context("spawn").Event()
    env = world(Cockpit(None, total_steps=103, steps_before=100, stop=stop), console)
    timer = threading.Timer(0.1, stop.set)
    state = env.reset()
    for _ in range(3):
        state = env.step_mdp(env.step(careless(state)))
    timer.start()
    with pytest.raises(KeyboardInterrupt):  # ends the process quietly
        env.step(careless(state))
    assert stop.is_set()
    assert console.frames[-1].notice == "all steps are driven" and console.frames[-1].step == 3
    env.close()


def test_it_ends_with_the_learner_while_the_person_pauses(console):
    stop = multiprocessing.get_context("spawn").Event()
    env = world(Cockpit(None, total_steps=10, stop=stop), console)
    state = env.reset()
    console.reading = Reading(connected=True, paused=True)
    timer = threading.Timer(0.1, stop.set)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        env.step(careless(state))
    assert console.frames[-1].notice == "paused"
    env.close()


# Somebody who only watches.
def test_an_agent_that_nobody_can_take_over_from_is_watched(console_class):
    looks = iter([Reading(paused=True)] * 2)

    def viewer(watched):
        return next(looks, Reading()) if watched.frames[-1].step == 3 else Reading()

    console = console_class(viewer)
    env = world(Cockpit(100.0, console=console))
    driven = rollout(env, 6)
    shown = [frame for frame in console.frames if not frame.notice]
    assert [frame.step for frame in shown] == list(range(7))
    assert {frame.driver for frame in shown} == {"agent"}
    assert not any(frame.takeover for frame in shown)
    assert [frame.figures.takeover_rate for frame in shown] == [0.0] * 7
    assert [(f.step, f.notice) for f in console.frames if f.notice] == [(3, "paused")]
    assert (column(driven, "step_time") == 0.0).nonzero().squeeze(-1).tolist() == [0, 3]
    env.close()
    quitting = console_class(lambda watched: Reading(quit=True))
    env = world(Cockpit(None, console=quitting))
    with pytest.raises(PersonQuit):
        rollout(env, 2)
    env.close()


def test_a_given_console_watches_a_machine_take_over(console):
    env = TransformedEnv(
        make_env(horizon=40, observation={"rays": 24}),
        Compose(
            InterventionTransform(ExpertMentor, Hold(RiskSwitch(), 5)),
            DisturbanceTransform(),
            Cockpit(None, console=console),
        ),
    )
    env.set_seed(0)
    torch.manual_seed(0)
    driven = rollout(env, 80)
    env.close()
    shown = [frame for frame in console.frames if frame.step > 0]
    assert [frame.takeover for frame in shown] == column(driven, "intervention").tolist()
    assert any(frame.takeover for frame in shown)


# What cannot be.
def test_a_world_that_cannot_be_shown_is_named_once(console):
    cockpit = Cockpit(None, console=console)
    env = TransformedEnv(GymEnv("Pendulum-v1"), cockpit)
    with pytest.raises(TypeError) as caught:
        env.reset()
    assert str(caught.value) == (
        "PendulumEnv cannot be shown to a person: it lacks snapshot(), road_polylines() or "
        "scenario_labels()."
    )
    assert caught.value.__cause__ is None and caught.value.__context__ is None
    assert not console.opened and not console.scenes
    env.close()


def test_without_a_console_any_world_keeps_the_pace():
    env = TransformedEnv(GymEnv("Pendulum-v1"), Cockpit(200.0))
    assert (env.rollout(4)["next", "step_time"].squeeze(-1) > 0.0).tolist() == [
        False, True, True, True
    ]  # fmt: skip
    env.close()


@pytest.mark.parametrize("pace", [0.0, -1.0, float("nan")])
def test_a_pace_that_is_none_is_refused(pace):
    with pytest.raises(ValueError, match=f"pace is {pace}"):
        Cockpit(pace)


def test_it_travels_to_another_process_before_it_is_used():
    window = WindowConsole(size=(900, 700))
    for twin in (
        pickle.loads(pickle.dumps(Cockpit(100.0, total_steps=5, console=window))),
        Cockpit(100.0, total_steps=5).clone(),
    ):
        assert (twin.pace, twin.total_steps) == (100.0, 5)
    twin = pickle.loads(pickle.dumps(Cockpit(100.0)))
    env = world(twin)
    assert len(rollout(env, 3)) == 3
    env.close()
