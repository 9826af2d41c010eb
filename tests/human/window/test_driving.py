"""A person in the window drives the real environment: takes over, lets go, is lost, comes back."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pygame
import pytest
import torch
from torchrl.envs import EnvBase, TransformedEnv

from haim_torchrl.envs import make_env
from haim_torchrl.human import Brake, Cockpit, HumanMentor, PersonQuit
from haim_torchrl.human.window import WindowConsole
from haim_torchrl.switches import RequestSwitch
from haim_torchrl.transforms import DisturbanceTransform, InterventionTransform

EMPTY = {
    "blocks": {"straight": 1.0},
    "traffic_density": 0.0,
    "side_traffic": 0.0,
    "obstacles": (1.0,),
    "lanes": (2,),
}


class Drive:
    """An environment, driven step by step by an agent that accelerates gently."""

    def __init__(self, env: EnvBase) -> None:
        self.env, self.state = env, env.reset()

    def step(self) -> Any:
        self.state["action"] = torch.tensor([0.1, 0.0])
        entries = self.env.step(self.state)["next"]
        self.state = entries
        return entries

    def steps_until(self, condition: Callable[[Any], bool], most: int = 10) -> int:
        """Steps until it holds."""
        for count in range(1, most + 1):
            if condition(self.step()):
                return count
        raise AssertionError(f"not within {most} steps")


@pytest.fixture
def drive() -> Iterator[Callable[..., Drive]]:
    """Starts a drive with a console."""
    environments = []

    def start(device: Any = "keyboard", fallback: Any = None) -> Drive:
        def mentor() -> HumanMentor:
            return HumanMentor(WindowConsole(device), fallback)

        env = TransformedEnv(
            make_env(scenario=EMPTY), InterventionTransform(mentor, RequestSwitch())
        )
        env.append_transform(DisturbanceTransform())
        env.append_transform(Cockpit(pace=100))
        environments.append(env)
        return Drive(env)

    yield start
    for env in environments:
        env.close()


def intervened(entries: Any) -> bool:
    return bool(entries["intervention"])


def test_keys_take_over_and_hand_back(drive: Callable[..., Drive], keys: Any) -> None:
    run = drive()
    for _ in range(3):
        assert not intervened(run.step())
    keys.down("up")
    entries = run.step()
    assert intervened(entries) and entries["takeover_start"] and entries["device_ok"]
    # 0.1 m/s² wished for by the agent, 1 by the key: at 10/s in 0.1 s the command is there at once.
    assert entries["behavior_action"].tolist() == pytest.approx([1.0, 0.0])
    assert entries["action_agent"].tolist() == pytest.approx([0.1, 0.0])
    keys.up("up")
    assert run.steps_until(lambda entries: not intervened(entries)) <= 6


def test_a_tap_of_the_space_bar_is_a_takeover(drive: Callable[..., Drive], keys: Any) -> None:
    run = drive()
    run.step()
    keys.tap("space")
    entries = run.step()
    assert intervened(entries) and entries["takeover_start"]
    assert run.steps_until(lambda entries: not intervened(entries)) <= 6


def test_a_wheel_takes_over_is_lost_and_comes_back(
    drive: Callable[..., Drive], plug: Callable[..., Any]
) -> None:
    device = plug()
    run = drive("wheel", Brake(-0.6))
    assert not intervened(run.step())
    device.press(4)  # a paddle
    device.move(0, -0.5)
    assert intervened(run.step())
    steering = [float(run.step()["behavior_action"][1]) for _ in range(3)]
    # Half of the way to the left, less a dead zone of 0.05 stretched to the full range.
    assert steering[-1] == pytest.approx(-(0.5 - 0.05) / 0.95, abs=1e-3)

    device.unplug()
    entries = run.step()
    assert not entries["device_ok"] and intervened(entries)
    assert entries["action_mentor"].tolist() == pytest.approx([-0.6, 0.0])

    device.plug_in()
    for axis in (1, 2, 3):
        device.move(axis, 1.0)
    assert run.steps_until(lambda entries: bool(entries["device_ok"]), 3) == 1
    assert run.steps_until(lambda entries: not intervened(entries)) <= 6
    device.move(2, -1.0)  # throttle
    entries = run.step()
    assert intervened(entries) and entries["behavior_action"][0] > 0.9


def test_without_the_focus_nothing_moves(drive: Callable[..., Drive], keys: Any) -> None:
    run = drive()
    keys.down("up")
    assert intervened(run.step())
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    back = pygame.event.Event(pygame.WINDOWFOCUSGAINED)
    timer = threading.Timer(0.2, pygame.event.post, (back,))
    timer.start()
    start = time.monotonic()
    entries = run.step()
    timer.join()
    assert time.monotonic() - start > 0.6  # 0.2 s away, and 0.5 s to find one's way back
    assert entries["device_ok"] and entries["step_time"] == 0.0
    # The key is not held any more, whatever the hand did meanwhile.
    assert run.steps_until(lambda entries: not intervened(entries)) <= 6


def test_a_pause_waits(drive: Callable[..., Drive], keys: Any) -> None:
    run = drive()
    run.step()
    keys.tap("p")
    timer = threading.Timer(0.3, keys.tap, ("p",))
    timer.start()
    start = time.monotonic()
    entries = run.step()
    timer.join()
    assert time.monotonic() - start > 0.25
    assert entries["step_time"] == 0.0 and not intervened(entries)


@pytest.mark.parametrize("how", ["escape", "window"])
def test_quitting_ends_the_run(drive: Callable[..., Drive], keys: Any, how: str) -> None:
    run = drive()
    run.step()
    keys.tap("escape") if how == "escape" else pygame.event.post(pygame.event.Event(pygame.QUIT))
    with pytest.raises(PersonQuit):
        run.step()
