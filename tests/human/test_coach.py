"""What a coach keeps, says and reports; values worked out by hand, and the real environment."""

import dataclasses
import pickle

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, TransformedEnv

from haim_torchrl.coach import main
from haim_torchrl.data import SessionWriter, read_session
from haim_torchrl.envs import make_env
from haim_torchrl.evaluation.recording import ScenarioLabels
from haim_torchrl.human import Cockpit, Reading
from haim_torchrl.human.coach import Coach
from haim_torchrl.human.coach_report import make_report
from haim_torchrl.human.takeovers import (
    ADVICE,
    ENOUGH,
    Takeover,
    TakeoverError,
    append_takeover,
    hint,
    read_takeovers,
    takeovers_of,
)
from haim_torchrl.mentors.expert import ExpertMentor
from haim_torchrl.switches import Forecast, Hold, RiskSwitch
from haim_torchrl.transforms import InterventionTransform, SessionRecorder
from haim_torchrl.transforms.intervention import Decision


class Simulator:
    """Foresees a collision in as many seconds as the agent's acceleration says, if positive."""

    def scenario_labels(self):
        return ScenarioLabels(7)

    def forecast(self, action):
        time = float(action[0])
        if time > 0.0:
            return Forecast(collision=True, time_to_collision=time)
        return Forecast()


def decide(agent=(0.0, 0.0), mentor=None, starting=False):
    agent = torch.tensor(agent)
    if mentor is None:
        return Decision(agent, torch.zeros(2), agent, False, False)
    mentor = torch.tensor(mentor)
    return Decision(agent, mentor, mentor, True, starting)


def after(cost=0.0, done=False):
    return TensorDict(cost=torch.tensor([cost]), done=torch.tensor([done]))


FREE = decide()
BEGIN = decide((0.25, 0.0), (0.55, 0.4), starting=True)  # at risk in 0.25 s, 0.5 apart
CALM = decide((0.0, 0.0), (0.0, 1.0), starting=True)  # no risk, 1.0 apart
HELD = decide((0.0, 0.0), (0.0, 1.0))


def watch(coach, decisions, simulator=None):
    return [coach(simulator or Simulator(), decision, after()) for decision in decisions]


def test_what_is_kept_of_a_takeover():
    coach = Coach(steps_before=100)
    watch(coach, [FREE, BEGIN, HELD, HELD, FREE, CALM, CALM])
    assert (coach.steps, coach.mentor_steps) == (7, 5)
    first, second = coach.takeovers  # a start within a takeover begins another one
    assert first.distance == pytest.approx(0.5)
    assert dataclasses.replace(first, distance=0.5) == Takeover(
        step=101, length=3, distance=0.5, scenario=7, risk=True, time_to_harm=0.25, collisions=0
    )
    assert second == Takeover(
        step=105, length=1, distance=1.0, scenario=7, risk=False, collisions=0
    )


def test_the_end_of_an_episode_ends_a_takeover():
    coach = Coach()
    coach(Simulator(), CALM, after(done=True))
    assert [takeover.length for takeover in coach.takeovers] == [1]


def test_a_simulator_that_tells_nothing():
    coach = Coach()
    watch(coach, [CALM, FREE], simulator=object())
    assert coach.takeovers == [Takeover(step=0, length=1, distance=1.0, collisions=0)]
    assert coach.takeovers[0].late is None


def test_collisions_of_the_agent_count_for_the_takeover_that_comes_next():
    coach = Coach()
    for decision, cost in [(FREE, 1.0), (FREE, 2.0), (CALM, 1.0), (FREE, 0.0), (CALM, 0.0)]:
        coach(Simulator(), decision, after(cost))
    coach(Simulator(), FREE, after())
    assert [takeover.collisions for takeover in coach.takeovers] == [3, 0]
    assert [takeover.late for takeover in coach.takeovers] == [True, False]


def test_the_forecast_is_asked_at_the_start_only():
    class Counting(Simulator):
        asked = 0

        def forecast(self, action):
            self.asked += 1
            return super().forecast(action)

    simulator = Counting()
    watch(Coach(), [FREE, BEGIN, HELD, HELD, FREE, CALM, HELD, FREE], simulator)
    assert simulator.asked == 2


def test_nothing_is_said_before_there_is_enough():
    said = watch(Coach(), [CALM, *[FREE] * 4] * ENOUGH)
    assert said[:-4] == [""] * (5 * ENOUGH - 4)  # the last takeover ends 4 steps before the end
    assert said[-4:] == ["good"] * 4


@pytest.mark.parametrize(
    ("takeover", "rate", "said"),
    [
        ({"risk": True, "time_to_harm": 0.4}, 0.1, "take over earlier"),
        ({"risk": True, "time_to_harm": 0.5}, 0.1, "good"),
        ({"risk": False, "collisions": 1}, 0.9, "take over earlier"),
        ({"risk": False}, 0.31, "let it explore"),
        ({"risk": False}, 0.30, "good"),
        ({"risk": True, "time_to_harm": 2.0}, 0.9, "good"),
        ({"risk": True, "time_to_harm": 2.0, "length": 51}, 0.1, "shorter"),
        ({"risk": True, "time_to_harm": 2.0, "length": 50}, 0.1, "good"),
        ({"length": 51}, 0.9, "shorter"),
        ({}, 0.9, ""),  # nobody knows why it began
    ],
)
def test_hints_follow_their_thresholds(takeover, rate, said):
    takeovers = [Takeover(**{"step": 0, "length": 10, "distance": 0.5, **takeover})]
    assert hint(takeovers, rate) == said
    assert said in ("", *ADVICE)


def test_three_late_takeovers_of_ten_are_too_many():
    late = Takeover(0, 10, 0.5, risk=True, time_to_harm=0.1)
    fine = Takeover(0, 10, 0.5, risk=True, time_to_harm=2.0)
    assert hint([late] * 3 + [fine] * 7, 0.1) == "take over earlier"
    assert hint([late] * 2 + [fine] * 8, 0.1) == "good"


def test_the_file_is_made_with_the_first_takeover_and_read_again(tmp_path):
    path = tmp_path / "run" / "takeovers.jsonl"
    coach = pickle.loads(pickle.dumps(Coach(path)))
    watch(coach, [FREE, FREE, BEGIN, HELD])
    assert not path.exists()  # it goes on
    watch(coach, [FREE])
    assert read_takeovers(path) == coach.takeovers
    watch(coach, [CALM, FREE])
    assert read_takeovers(path) == coach.takeovers and len(coach.takeovers) == 2
    path.write_text(path.read_text()[:-1])  # cut
    assert read_takeovers(path) == coach.takeovers[:1]


def test_a_resumed_run_replaces_what_is_driven_again(tmp_path):
    path = tmp_path / "takeovers.jsonl"
    steps = [10, 20, 30, 15, 40]  # saved after step 12, and gone on with
    for step in steps:
        append_takeover(path, Takeover(step, 1, 0.5))
    assert [takeover.step for takeover in read_takeovers(path)] == [10, 15, 40]


@pytest.mark.parametrize("line", ["nothing", '{"step": 1}', "[]"])
def test_a_foreign_file_is_one_sentence(tmp_path, line):
    path = tmp_path / "takeovers.jsonl"
    append_takeover(path, Takeover(0, 1, 0.5))
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(TakeoverError, match=r"line 2 of .* is no takeover"):
        read_takeovers(path)
    with pytest.raises(TakeoverError, match="do not exist"):
        read_takeovers(tmp_path / "away.jsonl")


def write_session(path):
    """Twelve steps in two episodes; the mentor drives 0-2 (3 apart), 5 (2), 6 (2) and 11 (0.5)."""
    driven = {0: 3.0, 1: 3.0, 2: 3.0, 5: 2.0, 6: 2.0, 11: 0.5}
    with SessionWriter(path) as writer:
        for step in range(12):
            if step in (0, 6):
                writer.begin_episode(scenario=step + 20)
            mentor = [driven.get(step, 0.0), 0.0]
            writer.add(
                [0.0, 0.0],
                mentor,
                mentor,
                intervention=step in driven,
                takeover_start=step in driven and step - 1 not in driven,
                done=step == 5,
            )
    return path


def test_the_takeovers_of_a_session(tmp_path):
    assert takeovers_of(read_session(write_session(tmp_path / "session.jsonl"))) == [
        Takeover(0, 3, 3.0, 20),
        Takeover(5, 1, 2.0, 20),
        Takeover(6, 1, 2.0, 26),  # the next episode: another takeover
        Takeover(11, 1, 0.5, 26),
    ]


def test_the_report_of_a_session_alone(tmp_path):
    report = make_report(session=read_session(write_session(tmp_path / "session.jsonl")))
    assert report.minutes == pytest.approx(1.2 / 60) and report.control == pytest.approx(0.6 / 60)
    assert report.takeovers == 4 and report.median_length == pytest.approx(0.1)
    assert report.risk is None and report.late is None and report.collisions is None
    assert report.spots == (("scenario 20", 2), ("scenario 26", 2)) and report.blocks == ()
    assert report.first is not None and report.last is not None
    assert (report.first.rate, report.first.distance) == (0.75, 3.0)
    assert (report.last.rate, report.last.distance) == (0.25, 0.5)
    assert report.hint == ""  # four takeovers say nothing
    assert "75% in the first third, 25% in the last" in str(report)
    assert "by risk" not in str(report)


def test_the_report_of_what_a_coach_kept():
    kept = [
        Takeover(0, 10, 0.5, 3, along=45.0, block="straight", risk=True, time_to_harm=0.1),
        Takeover(20, 20, 0.5, 3, along=59.9, block="straight", risk=True, time_to_harm=2.0),
        Takeover(50, 30, 0.5, 3, along=60.0, block="ramp", risk=False, collisions=2),
        Takeover(90, 30, 0.5, 4),
        Takeover(150, 30, 0.5, 4),
    ]
    report = make_report(kept, steps=600)
    assert report.minutes == pytest.approx(1.0) and report.rate == pytest.approx(0.2)
    assert report.median_length == pytest.approx(3.0)
    assert report.risk == pytest.approx(2 / 3) and report.late == pytest.approx(2 / 3)
    assert report.collisions == 2
    assert report.blocks == (("straight", 2), ("ramp", 1))
    assert report.spots == (
        ("scenario 3, 40 to 60 m", 2),
        ("scenario 4", 2),
        ("scenario 3, 60 to 80 m", 1),
    )
    assert report.hint == "take over earlier" and ADVICE[report.hint] in str(report)


@pytest.mark.parametrize(
    ("action", "nearer", "words"),
    [(3.0, 1.0, "came nearer"), (1.0, 3.0, "went away"), (1.9, 2.1, "hardly changed")],
)
def test_whether_the_policy_changed(action, nearer, words):
    transitions = TensorDict(
        {
            "observation": torch.tensor([[1.0], [2.0], [3.0]]),
            "action_agent": torch.tensor([[1.0], [9.0], [3.0]]),
            "action_mentor": torch.tensor([[4.0], [0.0], [4.0]]),  # 3 and 1 apart: 2 on average
            "intervention": torch.tensor([[True], [False], [True]]),
        },
        batch_size=[3],
    )

    def policy(observation):
        assert observation.tolist() == [[1.0], [3.0]]
        return torch.full((2, 1), action)

    report = make_report(transitions=transitions, policy=policy)
    assert report.before == 2.0 and report.after == pytest.approx(nearer)
    assert words in report.learned and words in str(report)
    assert make_report(transitions=transitions).after is None
    assert make_report(transitions=transitions[1:2], policy=policy).before is None


class Screen:
    """A console at which nobody sits; it keeps the hints."""

    def __init__(self):
        self.hints = []

    def open(self):
        pass

    def read(self):
        return Reading()

    def begin(self, scene):
        pass

    def show(self, frame):
        self.hints.append(frame.hint)

    def close(self):
        pass


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A careless agent and a shield in the real world, watched by a coach."""
    folder = tmp_path_factory.mktemp("run")
    screen = Screen()
    cockpit = Cockpit(pace=None, console=screen)
    shield = Hold(RiskSwitch(), 5)
    chain = Compose(
        InterventionTransform(ExpertMentor, shield),
        SessionRecorder(folder / "session.jsonl"),
        cockpit,
    )
    env = TransformedEnv(make_env(scenarios=20), chain)
    env.set_seed(0)
    torch.manual_seed(0)

    def careless(tensordict):
        wish = torch.tensor([0.25, 0.0]) + 0.3 * torch.randn(2)
        return tensordict.set("action", wish.clamp(-1.0, 1.0))

    rollout = env.rollout(300, careless, break_when_any_done=False)
    env.close()
    return folder, cockpit.coach, screen, rollout


def test_in_the_real_world_it_keeps_what_happened(run):
    folder, coach, screen, rollout = run
    kept = read_takeovers(folder / "takeovers.jsonl")
    assert kept == coach.takeovers and len(kept) >= ENOUGH
    following = rollout["next"]
    starts = following["takeover_start"].squeeze(-1).nonzero().squeeze(-1).tolist()
    assert [takeover.step for takeover in kept] == starts[: len(kept)]
    from_session = takeovers_of(read_session(folder))[: len(kept)]
    for takeover, recorded in zip(kept, from_session):
        assert takeover.length == recorded.length and takeover.scenario == recorded.scenario
        assert takeover.distance == pytest.approx(recorded.distance, abs=1e-6)
        assert takeover.along is not None and takeover.along > 0.0
        assert takeover.x is not None and np.isfinite([takeover.x, takeover.y]).all()
        assert (takeover.time_to_harm is not None) == takeover.risk
    assert any(takeover.risk for takeover in kept)  # a shield begins at risk
    assert any(takeover.block is not None for takeover in kept)
    assert screen.hints[0] == "" and screen.hints[-1] in ADVICE


def test_the_command_prints_the_report(run, capsys, tmp_path):
    folder = run[0]
    main([str(folder)])
    said = capsys.readouterr().out
    assert said.startswith("driving") and "by block" in said and "advice" in said
    with pytest.raises(SystemExit) as error:
        main([str(tmp_path)])
    assert error.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_run_in_several_files_is_one_run(tmp_path, capsys):
    for name in ("session.jsonl", "session_2.jsonl", "session_10.jsonl", "session.after-9.jsonl"):
        write_session(tmp_path / name)
    main([str(tmp_path), "--time-step", "5"])  # 12 steps a file: 3 minutes
    said = capsys.readouterr().out.split("\n")
    assert said[0].split() == ["driving", "3.0", "min"]
    assert said[2].split() == ["takeovers", "12"]
    main([str(tmp_path / "session_2.jsonl"), "--time-step", "5"])
    assert capsys.readouterr().out.split()[:3] == ["driving", "1.0", "min"]
