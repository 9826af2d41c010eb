"""Compiled look-ahead for the AV: where a manoeuvre leads, on its route and among others.

Used by the risk forecast (what if the agent's action is carried out?) and by the rule-based
mentor (which of my options is free?).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from haim_torchrl.envs.carriageway import Surroundings
from haim_torchrl.envs.geometry import HALF_LENGTH, HALF_WIDTH, overlaps
from haim_torchrl.envs.path import Array, interpolate, project

TIME_STEP = 0.1
"""Time step of the look-ahead [s]."""
PREDICTION_STEP = 0.2
"""Time between two predicted poses of the others [s]; a whole number of time steps."""
LANE_MARGIN = 1.2
"""How near to the road's edge the AV steers when it keeps its offset [m]."""
LATERAL_SPEED = 1.5
"""How fast the AV changes its offset at most [m/s]; measured: without a limit a lane change begins
with the wheel turned fully, and a clone of the mentor left the road twice as often."""
NEAR = 14.0
"""Bodies whose centre is farther away than this cannot touch the AV, margins included [m]."""


@dataclass(frozen=True)
class Manoeuvre:
    """What the AV does in a look-ahead.

    Attributes:
        then: acceleration after the first command [m/s²], with steering by pure pursuit.
        target_d: offset on the route to steer for then [m]; NaN: the one reached by then.
        hold: how long the first command is held [s]; 0: there is none.
        acceleration, steering: the first command [m/s², rad].
        max_speed: limit of the speed [m/s].
        horizon: how far to look [s].
    """

    then: float
    target_d: float = np.nan
    hold: float = 0.0
    acceleration: float = 0.0
    steering: float = 0.0
    max_speed: float = 15.0
    horizon: float = 4.0


@dataclass(frozen=True)
class Margins:
    """How far a manoeuvre has to stay away from things [m].

    Attributes:
        road: from the road's edge to the AV's centre.
        ahead: added to the half lengths of others that move.
        beside: added to the half widths of others.
        still: added to the half lengths of others that stand still.
    """

    road: float
    ahead: float
    beside: float
    still: float


class Outlook(NamedTuple):
    """What a manoeuvre leads to.

    Attributes:
        time_to_collision, time_to_departure: of the first collision and of leaving the road [s];
            inf: neither happens.
        lateral_acceleration: the largest during the first command [m/s²].
        clearance: the least distance between the road's edge and the AV's centre during the first
            command [m]; inf without one.
    """

    time_to_collision: float
    time_to_departure: float
    lateral_acceleration: float
    clearance: float

    @property
    def free(self) -> bool:
        """Whether the manoeuvre neither collides nor leaves the road."""
        return bool(np.isinf(self.time_to_collision) and np.isinf(self.time_to_departure))


def look_ahead(road: Surroundings, manoeuvre: Manoeuvre, margins: Margins) -> Outlook:
    """Where a manoeuvre of the AV leads, if the others go on as predicted."""
    av, model, route = road.av, road.av.model, road.scenario.route
    return Outlook(
        *_look_ahead(
            av.position[0], av.position[1], av.heading, av.speed,
            manoeuvre.acceleration, manoeuvre.steering, manoeuvre.hold,
            manoeuvre.then, manoeuvre.target_d,
            model.steering, model.wheelbase, model.length / 2, model.width / 2,
            manoeuvre.max_speed, manoeuvre.horizon,
            route.x, route.y, route.heading, road.scenario.half_width, margins.road,
            road.others, road.predicted(), margins.ahead, margins.beside, margins.still,
        )
    )  # fmt: skip


@njit(cache=True)
def pursue(
    x: float, y: float, heading: float, speed: float, target_d: float,
    xs: Array, ys: Array, headings: Array, limit: float, wheelbase: float,
) -> float:  # fmt: skip
    """Front-wheel angle [rad] that leads to lateral offset `target_d` [m] (pure pursuit).

    The point pursued is moved to the side only as far as keeps the lateral speed below
    `LATERAL_SPEED`: a lane change is a ramp of some seconds, at any speed.

    Args:
        x, y, heading, speed: the vehicle [m, m, rad, m/s].
        target_d: offset on the path to drive at [m].
        xs, ys, headings: the path.
        limit: largest angle [rad].
        wheelbase: distance of the axles [m].
    """
    s, d = project(x, y, xs, ys, headings)
    look = 4.0 + 0.6 * speed
    shift = LATERAL_SPEED * look / max(speed, 0.1)
    target_d = d + min(max(target_d - d, -shift), shift)
    tx, ty, _ = interpolate(s + look, target_d, xs, ys, headings)
    dx, dy = tx - x, ty - y
    distance = max(np.hypot(dx, dy), 1.0)
    bearing = (np.arctan2(dy, dx) - heading + np.pi) % (2 * np.pi) - np.pi
    sine = min(max(2 * np.sin(bearing) / distance * wheelbase / 2, -0.9), 0.9)
    return min(max(np.arctan(2 * np.tan(np.arcsin(sine))), -limit), limit)


@njit(cache=True)
def _look_ahead(
    x: float, y: float, heading: float, speed: float,
    acceleration: float, steering: float, hold: float, then: float, target_d: float,
    limit: float, wheelbase: float, own_half_length: float, own_half_width: float,
    max_speed: float, horizon: float,
    xs: Array, ys: Array, headings: Array, half_width: float, road_margin: float,
    bodies: Array, poses: Array, ahead_margin: float, side_margin: float, still_margin: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """The compiled part of :func:`look_ahead`; `poses` as of `geometry.predict`, [T, M, 3]."""
    hit, left, lateral, clearance = np.inf, np.inf, 0.0, np.inf
    keeps_offset = np.isnan(target_d)
    for k in range(round(horizon / TIME_STEP)):
        t = k * TIME_STEP
        held = t < hold - 1e-6
        if held:
            delta, pedal = steering, acceleration
        else:
            if keeps_offset:
                _, d = project(x, y, xs, ys, headings)
                inner = half_width - road_margin - LANE_MARGIN
                target_d = min(max(d, -inner), inner)
                keeps_offset = False
            delta = pursue(x, y, heading, speed, target_d, xs, ys, headings, limit, wheelbase)
            pedal = then
        beta = np.arctan(np.tan(delta) / 2)
        yaw = speed * np.sin(beta) / (wheelbase / 2)
        if held:
            lateral = max(lateral, abs(speed * yaw))
        x += speed * np.cos(heading + beta) * TIME_STEP
        y += speed * np.sin(heading + beta) * TIME_STEP
        heading += yaw * TIME_STEP
        speed = min(max(speed + pedal * TIME_STEP, 0.0), max_speed)
        _, d = project(x, y, xs, ys, headings)
        if held:
            clearance = min(clearance, half_width - abs(d))
        if abs(d) > half_width - road_margin:
            left = t + TIME_STEP
        step = round((t + TIME_STEP) / PREDICTION_STEP - 1)
        predicted = abs((step + 1) * PREDICTION_STEP - t - TIME_STEP) < 1e-6
        if predicted and 0 <= step < len(poses):
            for m in range(bodies.shape[0]):
                px, py, ph = poses[step, m]
                if (px - x) ** 2 + (py - y) ** 2 > NEAR * NEAR:
                    continue
                moved = np.hypot(poses[-1, m, 0] - poses[0, m, 0], poses[-1, m, 1] - poses[0, m, 1])
                longer = still_margin if moved < 0.1 else ahead_margin
                if overlaps(
                    x, y, heading, own_half_length, own_half_width, px, py, ph,
                    bodies[m, HALF_LENGTH] + longer, bodies[m, HALF_WIDTH] + side_margin,
                ):  # fmt: skip
                    hit = t + TIME_STEP
                    break
        stands = speed <= 0.0 and pedal <= 0.0 and t >= hold
        if hit < np.inf or left < np.inf or stands:
            break
    return hit, left, lateral, clearance
