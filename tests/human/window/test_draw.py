"""The picture: what is where, in which colour, off-screen, at any size."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pygame
import pytest

from haim_torchrl.evaluation.pictures import COLORS
from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.human import Figures, Frame, Scene
from haim_torchrl.human.window import Painter
from haim_torchrl.human.window.camera import Camera, runs
from haim_torchrl.human.window.hud import WIDTH
from haim_torchrl.human.window.view import DRIVERS

SIZE = (1100, 700)
X = np.linspace(-100.0, 200.0, 301)


def line(y: float, **settings: Any) -> RoadLine:
    return RoadLine(np.stack([X, np.full_like(X, y)], axis=1), **settings)


# A straight road along +x with two lanes; the vehicle drives in the right-hand one.
SCENE = Scene(
    0,
    ScenarioLabels(7, ("straight",)),
    [line(4.0), line(0.0, edge=False), line(-4.0), line(0.0, edge=False, route=True)],
)
SNAPSHOT = Snapshot(
    time=1.0,
    vehicle=np.array([0.0, -2.0, 0.0, 5.0, 2.0]),
    speed=8.0,
    acceleration=0.0,
    followers=np.array([[-20.0, -2.0, 0.0, 5.0, 2.0]]),
    follower_speeds=np.array([7.0]),
    follower_accelerations=np.array([0.0]),
    follower_gaps=np.array([15.0]),
    traffic=np.array([[30.0, 2.0, 0.0, 5.0, 2.0]]),
    obstacles=np.array([[20.0, -2.0, 0.0, 2.0, 2.0]]),
)
FRAME = Frame(0, 1, SNAPSHOT)


def drawn(frame: Frame, size: tuple[int, int] = SIZE, view: Any = "heading") -> Any:
    painter, surface = Painter("keys", "keyboard", view), pygame.Surface(size)
    painter.begin(SCENE)
    painter.draw(surface, frame)
    return surface


def color_at(surface: Any, x: float, y: float) -> tuple[int, ...]:
    return tuple(surface.get_at((round(x), round(y))))[:3]


def rgb(color: str) -> tuple[int, ...]:
    return tuple(pygame.Color(color))[:3]


def places(surface: Any, color: str) -> np.ndarray:
    """Pixels of the view in a colour, ``[n, 2]``."""
    pixels = pygame.surfarray.array3d(surface)[: SIZE[0] - WIDTH]
    return np.argwhere((pixels == rgb(color)).all(axis=-1))


def test_pixels_by_hand() -> None:
    """2 pixels a metre; up is +y: right is right, up is up. Up is +x: ahead is up, left is left."""
    north = Camera((10.0, 5.0), math.pi / 2, 2.0, (100.0, 50.0), (200, 100))
    assert north.pixels(np.array([[10.0, 5.0], [11.0, 5.0], [10.0, 8.0]])) == pytest.approx(
        np.array([[100.0, 50.0], [102.0, 50.0], [100.0, 44.0]])
    )
    ahead = replace(north, up=0.0)
    assert ahead.pixels(np.array([[20.0, 5.0], [10.0, 6.0]])) == pytest.approx(
        np.array([[100.0, 30.0], [98.0, 50.0]])
    )
    assert ahead.shows(np.array([[0.0, 0.0], [-50.0, 0.0]])).tolist() == [True, False]
    assert runs(np.array([True, True, False, True])) == [slice(0, 2), slice(3, 4)]


@pytest.mark.parametrize("driver", ["agent", "person", "fallback"])
def test_the_vehicle_has_the_colour_of_its_driver(driver: Any) -> None:
    surface = drawn(replace(FRAME, driver=driver))
    x, y = places(surface, DRIVERS[driver]).mean(axis=0)
    # The vehicle's middle, about: its label beside it has the colour, too.
    assert abs(x - 400) < 40 and abs(y - 385) < 15
    for other in set(DRIVERS) - {driver}:
        assert not len(places(surface, DRIVERS[other]))
    assert color_at(surface, SIZE[0] - WIDTH + 5, 5) == rgb(DRIVERS[driver])


def test_followers_are_behind_and_obstacles_and_traffic_ahead() -> None:
    surface = drawn(FRAME)
    scale = SIZE[1] / 115.0
    spots = {
        name: np.median(places(surface, COLORS[name]), axis=0) for name in ("obstacles", "traffic")
    }
    assert spots["obstacles"] == pytest.approx([400, 385 - 20 * scale], abs=6)
    assert spots["traffic"] == pytest.approx([400 - 4 * scale, 385 - 30 * scale], abs=8)
    assert color_at(surface, 400, 385 + 21 * scale) == rgb(COLORS["followers"])


def test_north_stays_up_when_asked_for() -> None:
    surface = drawn(FRAME, view="north")
    x, y = np.median(places(surface, COLORS["traffic"]), axis=0)
    scale = SIZE[1] / 115.0
    assert (x, y) == pytest.approx((400 + 30 * scale, 350 - 4 * scale), abs=8)


def test_brake_lights() -> None:
    plain, lit = (
        drawn(replace(FRAME, snapshot=replace(SNAPSHOT, acceleration=a))) for a in (0.0, -3.0)
    )
    assert not len(places(plain, "#ff2a1a")) and len(places(lit, "#ff2a1a")) > 5


def test_the_gauge_points_where_the_agent_steers() -> None:
    """Full throttle, full right: the upper right corner of the left gauge, and not the lower."""
    surface = drawn(replace(FRAME, action_agent=(1.0, 1.0)))
    x, y = SIZE[0] - WIDTH + 18 + 61, 62 + 20 + 61
    assert color_at(surface, x + 51, y - 51) == rgb(DRIVERS["agent"])
    assert color_at(surface, x + 51, y + 51) != rgb(DRIVERS["agent"])


CHANGES = {
    "takeover": {"takeover": True},
    "disturbance": {"disturbance": True},
    "cost": {"cost": 1.0},
    "takeover cost": {"takeover_cost": 0.5},
    "disturbance cost": {"disturbance_cost": 0.5},
    "speed": {"snapshot": replace(SNAPSHOT, speed=3.0)},
    "action": {"action_mentor": (0.3, 0.2), "driver": "person"},
    "successes": {"figures": Figures(successes=1, episodes=1)},
    "violations": {"figures": Figures(violations=1)},
    "takeovers": {"figures": Figures(takeovers=2)},
    "rate": {"figures": Figures(takeover_rate=0.5)},
    "steps": {"figures": Figures(steps=5, total_steps=10)},
    "time left": {"figures": Figures(seconds_left=3725.0)},
    "device": {"device_ok": False},
    "latency": {"latency_ms": 12.0},
    "notice": {"notice": "paused"},
    "hint": {"hint": "Look ahead."},
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_everything_a_frame_says_is_seen(change: dict[str, Any]) -> None:
    plain, changed = (
        pygame.surfarray.array3d(drawn(frame)) for frame in (FRAME, replace(FRAME, **change))
    )
    assert (plain != changed).any(axis=-1).sum() > 8


@pytest.mark.parametrize("size", [(800, 600), (1100, 700), (1920, 1080), (310, 200)])
def test_any_size_can_be_drawn(size: tuple[int, int]) -> None:
    surface = drawn(replace(FRAME, notice="connection lost: waiting for the driver"), size)
    assert len(np.unique(pygame.surfarray.array2d(surface))) > 20


def test_an_empty_world_can_be_drawn() -> None:
    painter, surface = Painter(), pygame.Surface(SIZE)
    painter.begin(Scene(0, ScenarioLabels(0), []))
    empty = Snapshot(time=0.0, vehicle=SNAPSHOT.vehicle, speed=0.0, acceleration=0.0)
    painter.draw(surface, Frame(0, 0, empty))
    assert len(places(surface, DRIVERS["agent"])) > 100
