"""Scenes and frames as JSON for the page.

Positions are metres, x to the right and y up, headings counter-clockwise in rad, as in
:mod:`haim_torchrl.evaluation.recording`. They are rounded to centimetres (headings to 0.001 rad);
actions and costs keep all their digits. What is not finite becomes null, since JSON has no NaN.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from haim_torchrl.evaluation.recording import RoadLine
from haim_torchrl.human.console import Frame, Scene

TOLERANCE = 0.02
"""How far a road line may be from the one that is sent [m]."""


def encode_scene(scene: Scene) -> str:
    """JSON of a scene: episode, scenario's labels, lines of the road."""
    return _dump(
        {
            "type": "scene",
            "episode": scene.episode,
            "scenario": scene.labels.index,
            "blocks": list(scene.labels.blocks),
            "obstacles": scene.labels.obstacles,
            "road": [
                {
                    "kind": "route" if line.route else "edge" if line.edge else "marking",
                    "points": _points(line),
                }
                for line in scene.road
            ],
        }
    )


def encode_frame(frame: Frame) -> str:
    """JSON of a frame, with the names of :class:`~haim_torchrl.human.Frame` and its parts."""
    snapshot, figures = frame.snapshot, frame.figures
    return _dump(
        {
            "type": "frame",
            "episode": frame.episode,
            "step": frame.step,
            "time": _number(snapshot.time, 3),
            "vehicle": _boxes(snapshot.vehicle)[0],
            "speed": _number(snapshot.speed),
            "acceleration": _number(snapshot.acceleration, 3),
            "distance": _number(snapshot.distance, 2),
            "followers": _boxes(snapshot.followers),
            "follower_speeds": [_number(speed, 3) for speed in snapshot.follower_speeds],
            "follower_gaps": [_number(gap, 2) for gap in snapshot.follower_gaps],
            "traffic": _boxes(snapshot.traffic),
            "obstacles": _boxes(snapshot.obstacles),
            "driver": frame.driver,
            "action": [_number(value) for value in frame.action],
            "action_agent": [_number(value) for value in frame.action_agent],
            "action_mentor": [_number(value) for value in frame.action_mentor],
            "takeover": frame.takeover,
            "disturbance": frame.disturbance,
            "cost": _number(frame.cost),
            "takeover_cost": _number(frame.takeover_cost),
            "disturbance_cost": _number(frame.disturbance_cost),
            "steps": figures.steps,
            "total_steps": figures.total_steps,
            "seconds_left": _number(figures.seconds_left, 1),
            "episodes": figures.episodes,
            "successes": figures.successes,
            "violations": figures.violations,
            "takeovers": figures.takeovers,
            "takeover_rate": _number(figures.takeover_rate),
            "device_ok": frame.device_ok,
            "latency_ms": _number(frame.latency_ms, 1),
            "notice": frame.notice,
            "hint": frame.hint,
        }
    )


def _dump(entries: dict[str, Any]) -> str:
    return json.dumps(entries, separators=(",", ":"), allow_nan=False)


def _number(value: float | None, digits: int | None = None) -> float | None:
    if value is None or not math.isfinite(value):
        return None
    return float(value) if digits is None else round(float(value), digits)


def _boxes(boxes: Any) -> list[list[float] | None]:
    """Boxes, ``[n, 5]``; null for one with a value that is not finite: it cannot be drawn."""
    table = np.asarray(boxes, dtype=float).reshape(-1, 5)
    drawn = np.isfinite(table).all(axis=1).tolist()
    rows = zip(table.round(2).tolist(), table[:, 2].round(3).tolist(), drawn)
    return [[x, y, heading, a, b] if ok else None for (x, y, _, a, b), heading, ok in rows]


def _points(line: RoadLine) -> list[list[float]]:
    """The points of a line that it takes to draw it, ``[p, 2]``."""
    points = np.asarray(line.points, dtype=float)[:, :2]
    points = points[np.isfinite(points).all(axis=1)]
    return points[_corners(points)].round(2).tolist()


def _corners(points: np.ndarray) -> list[int]:
    """Which points a line needs to stay within :data:`TOLERANCE` (Douglas and Peucker, 1973)."""
    last = len(points) - 1
    kept, parts = {0, last} if last >= 0 else set(), [(0, last)]
    while parts:
        start, end = parts.pop()
        if end - start < 2:
            continue
        chord = points[end] - points[start]
        offsets = points[start + 1 : end] - points[start]
        length = float(np.hypot(*chord))
        if length > 0.0:
            along = np.clip(offsets @ chord / length**2, 0.0, 1.0)
            offsets = offsets - along[:, None] * chord
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        worst = int(distances.argmax())
        if distances[worst] > TOLERANCE:
            middle = start + 1 + worst
            kept.add(middle)
            parts += [(start, middle), (middle, end)]
    return sorted(kept)
