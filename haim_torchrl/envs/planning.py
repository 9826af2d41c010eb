"""Compiled look-ahead for the AV: where a manoeuvre leads, on its route and among others.

Used by the risk forecast (what if the agent's action is carried out?) and by the rule-based
mentor (which of my options is free?).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from haim_torchrl.envs.geometry import HALF_LENGTH, HALF_WIDTH, overlaps
from haim_torchrl.envs.path import Array, interpolate, project

TIME_STEP = 0.1
WHEELBASE = 5.0


@njit(cache=True)
def pursue(
    x: float, y: float, heading: float, speed: float, target_d: float,
    xs: Array, ys: Array, headings: Array, limit: float,
) -> float:
    """Front-wheel angle [rad] that leads to lateral offset `target_d` [m] (pure pursuit).

    Args:
        x, y, heading, speed: the vehicle [m, m, rad, m/s].
        target_d: offset on the path to drive at [m].
        xs, ys, headings: the path.
        limit: largest angle [rad].
    """
    s, _ = project(x, y, xs, ys, headings)
    look = 4.0 + 0.6 * speed
    tx, ty, _ = interpolate(s + look, target_d, xs, ys, headings)
    dx, dy = tx - x, ty - y
    distance = max(np.hypot(dx, dy), 1.0)
    bearing = (np.arctan2(dy, dx) - heading + np.pi) % (2 * np.pi) - np.pi
    sine = min(max(2 * np.sin(bearing) / distance * WHEELBASE / 2, -0.9), 0.9)
    return min(max(np.arctan(2 * np.tan(np.arcsin(sine))), -limit), limit)


@njit(cache=True)
def look_ahead(
    x: float, y: float, heading: float, speed: float,
    acceleration: float, steering: float, hold: float, then: float, target_d: float,
    limit: float, max_speed: float, horizon: float,
    xs: Array, ys: Array, headings: Array, half_width: float,
    bodies: Array, poses: Array, poses_dt: float,
    long_margin: float, side_margin: float, still_margin: float,
) -> tuple[float, float, float, float]:
    """Carry out a command for a while, then another along the route, and see what happens.

    Args:
        x, y, heading, speed: the AV [m, m, rad, m/s].
        acceleration, steering: first command [m/s², rad].
        hold: how long the first command is held [s].
        then: acceleration afterwards [m/s²], with steering by pure pursuit.
        target_d: offset on the route to steer for afterwards [m]; NaN: the one reached by then.
        limit, max_speed: bounds of wheel angle [rad] and speed [m/s].
        horizon: how far to look [s].
        xs, ys, headings, half_width: the route and half of its carriageway's width [m].
        bodies, poses, poses_dt: the others, [M, 10], their predicted poses, [T, M, 3], and the
            time between these [s].
        long_margin, side_margin, still_margin: added to the others' half lengths, half widths, and
            to the half lengths of those that stand still [m].

    Returns:
        Times of the first collision and of leaving the road [s] (inf: neither), largest lateral
        acceleration [m/s²], and the distance driven [m].
    """
    hit, left, lateral, driven = np.inf, np.inf, 0.0, 0.0
    held = np.isnan(target_d)
    for k in range(int(round(horizon / TIME_STEP))):
        t = k * TIME_STEP
        if t < hold - 1e-6:
            delta, pedal = steering, acceleration
        else:
            if held:
                _, d = project(x, y, xs, ys, headings)
                target_d = min(max(d, -half_width + 1.2), half_width - 1.2)
                held = False
            delta = pursue(x, y, heading, speed, target_d, xs, ys, headings, limit)
            pedal = then
        beta = np.arctan(np.tan(delta) / 2)
        yaw = speed * np.sin(beta) / (WHEELBASE / 2)
        if t < hold - 1e-6:
            lateral = max(lateral, abs(speed * yaw))
        x += speed * np.cos(heading + beta) * TIME_STEP
        y += speed * np.sin(heading + beta) * TIME_STEP
        heading += yaw * TIME_STEP
        driven += speed * TIME_STEP
        speed = min(max(speed + pedal * TIME_STEP, 0.0), max_speed)
        _, d = project(x, y, xs, ys, headings)
        if abs(d) > half_width and left == np.inf:
            left = t + TIME_STEP
        step = int(round((t + TIME_STEP) / poses_dt - 1))
        if step >= 0 and abs((step + 1) * poses_dt - t - TIME_STEP) < 1e-6 and step < len(poses):
            for m in range(bodies.shape[0]):
                px, py, ph = poses[step, m]
                if (px - x) ** 2 + (py - y) ** 2 > 196.0:
                    continue
                still = np.hypot(poses[-1, m, 0] - poses[0, m, 0], poses[-1, m, 1] - poses[0, m, 1])
                longer = still_margin if still < 0.1 else long_margin
                if overlaps(
                    x, y, heading, WHEELBASE / 2, 1.0,
                    px, py, ph, bodies[m, HALF_LENGTH] + longer, bodies[m, HALF_WIDTH] + side_margin,
                ):
                    hit = t + TIME_STEP
                    break
        if hit < np.inf or left < np.inf or (speed <= 0.0 and pedal <= 0.0 and t >= hold):
            break
    return hit, left, lateral, driven
