"""The top view: it follows the automated vehicle."""

from __future__ import annotations

import math
from collections import deque
from typing import Any, Literal

import numpy as np

from haim_torchrl.evaluation.pictures import COLORS
from haim_torchrl.human.console import Frame, Scene
from haim_torchrl.human.window.camera import Array, Camera, polygon, ribbon
from haim_torchrl.human.window.road import GROUND, Road
from haim_torchrl.human.window.text import Writer

DRIVERS = {"agent": COLORS["vehicle"], "person": COLORS["mentor"], "fallback": "#a86f00"}
"""Colour of the vehicle by who drives it."""
HEIGHT = 115.0
"""Metres from the lower edge of the picture to the upper one."""
TURNING = 0.5
"""Time in which the picture follows a turn of the vehicle [s]."""
TRAIL = 150
"""Steps of the path behind the vehicle."""
BRAKING = -1.0
"""Acceleration below which brake lights are on [m/s²]."""

_BODY = np.array([[1, 0.55], [0.82, 1], [-0.85, 1], [-1, 0.7], [-1, -0.7], [-0.85, -1],
                  [0.82, -1], [1, -0.55]])  # fmt: skip
_WINDSCREEN = np.array([[0.42, 0.8], [0.15, 0.72], [0.15, -0.72], [0.42, -0.8]])
_LIGHTS = np.array([[-0.86, 0.95], [-1, 0.7], [-1, -0.7], [-0.86, -0.95]])


class View:
    """Draws the scene around the vehicle.

    Args:
        writer: writes the speeds.
        up: what is up, the vehicle's heading or +y.
    """

    def __init__(self, writer: Writer, up: Literal["heading", "north"] = "heading") -> None:
        self._writer = writer
        self._up = up
        self._road = Road([])
        self._trail: deque[tuple[float, float, str]] = deque(maxlen=TRAIL)
        self._heading: float | None = None
        self._step, self._time = -1, 0.0

    def begin(self, scene: Scene) -> None:
        """A new road, and no path on it yet."""
        self._road = Road(scene.road)
        self._trail.clear()
        self._heading, self._step = None, -1

    def draw(self, surface: Any, frame: Frame) -> None:
        """Draw a step over the whole surface."""
        camera = self._camera(frame, surface.get_size())
        snapshot = frame.snapshot
        surface.fill(GROUND)
        self._road.draw(surface, camera)
        self._draw_trail(surface, camera)
        _draw_cars(surface, camera, snapshot.traffic, COLORS["traffic"])
        for box in np.asarray(snapshot.obstacles).reshape(-1, 5):
            _draw_obstacle(surface, camera, box)
        brakes = np.asarray(snapshot.follower_accelerations) < BRAKING
        _draw_cars(surface, camera, snapshot.followers, COLORS["followers"], brakes)
        color = DRIVERS[frame.driver]
        brakes = np.array([snapshot.acceleration < BRAKING])
        _draw_cars(surface, camera, snapshot.vehicle, color, brakes, outline="#101010")
        for box, speed in zip(np.asarray(snapshot.followers), snapshot.follower_speeds):
            self._label(surface, camera, box, f"{speed:.1f}", COLORS["followers"])
        self._label(surface, camera, snapshot.vehicle, f"{snapshot.speed:.1f} m/s", color)

    def _camera(self, frame: Frame, area: tuple[int, int]) -> Camera:
        x, y, heading = (float(value) for value in frame.snapshot.vehicle[:3])
        if frame.step != self._step:
            if self._heading is None:
                self._heading = heading
            passed = max(frame.snapshot.time - self._time, 0.0)
            turn = math.remainder(heading - self._heading, math.tau)
            self._heading += turn * (1.0 - math.exp(-passed / TURNING))
            self._step, self._time = frame.step, frame.snapshot.time
            self._trail.append((x, y, DRIVERS[frame.driver]))
        width, height = area
        if self._up == "north" or self._heading is None:
            return Camera((x, y), math.pi / 2.0, height / HEIGHT, (width / 2, height / 2), area)
        return Camera((x, y), self._heading, height / HEIGHT, (width / 2, 0.55 * height), area)

    def _draw_trail(self, surface: Any, camera: Camera) -> None:
        """The path driven, in the colours of who drove."""
        trail = list(self._trail)
        start = 0
        for stop in range(1, len(trail)):
            if stop == len(trail) - 1 or trail[stop + 1][2] != trail[stop][2]:
                points = camera.pixels(np.array([p[:2] for p in trail[start : stop + 1]]))
                moved = np.linalg.norm(np.diff(points, axis=0, prepend=points[:1] - 9.0), axis=1)
                ribbon(surface, trail[stop][2], points[moved > 0.5], 1.2)
                start = stop

    def _label(self, surface: Any, camera: Camera, box: Array, text: str, color: str) -> None:
        place = camera.pixels(np.asarray(box[:2]))
        if not camera.shows(place):
            return
        x, y = place
        picture = self._writer.picture(text, 12, color, True)
        area = picture.get_rect(midleft=(round(x + 0.5 * camera.scale * box[3] - 2), round(y)))
        surface.fill("#ffffff", area.inflate(8, 4))
        surface.blit(picture, area)


def _draw_cars(
    surface: Any,
    camera: Camera,
    boxes: Array,
    color: str,
    brakes: Any = (),
    outline: str = "#3a3a3a",
) -> None:
    boxes = np.asarray(boxes, dtype=float).reshape(-1, 5)
    lit = np.zeros(len(boxes), dtype=bool)
    lit[: len(brakes)] = brakes[: len(boxes)]
    shown = camera.shows(camera.pixels(boxes[:, :2]))
    for box, light in zip(boxes[shown], lit[shown]):
        polygon(surface, color, camera.pixels(_placed(_BODY, box)), outline)
        polygon(surface, "#2b3440", camera.pixels(_placed(_WINDSCREEN, box)))
        if light:
            polygon(surface, "#ff2a1a", camera.pixels(_placed(_LIGHTS, box)))


def _draw_obstacle(surface: Any, camera: Camera, box: Array) -> None:
    """A box with a cross on it, which no vehicle has."""
    frame = camera.pixels(_placed(np.array([[1.0, 1.0], [-1, 1], [-1, -1], [1, -1]]), box))
    polygon(surface, COLORS["obstacles"], frame, "#6d3a06")
    for ends in (frame[[0, 2]], frame[[1, 3]]):
        ribbon(surface, "#6d3a06", ends, 0.8)


def _placed(shape: Array, box: Array) -> Array:
    """A shape within [-1, 1] put where a box is, ``[n, 2]`` in m."""
    x, y, heading, length, width = box
    offset = shape * (0.5 * length, 0.5 * width)
    cos, sin = math.cos(heading), math.sin(heading)
    return offset @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
