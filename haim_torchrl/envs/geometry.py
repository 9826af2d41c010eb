"""Compiled geometry of the scene: neighbours, predictions, overlaps, rays.

Bodies are rows of one array with the columns below; paths are slices of one flat table. These
loops replace highway-env's per-vehicle Python searches, which are most of its step's cost.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from haim_torchrl.envs.path import Array, interpolate, project

X, Y, HEADING, SPEED, ACCELERATION, HALF_LENGTH, HALF_WIDTH, PATH, S, D = range(10)
"""Columns of a body: centre [m], heading [rad], speed [m/s], acceleration [m/s²], half extents
[m], index of the path it drives, and arc length and offset on that path [m]."""
COLUMNS = 10


@njit(cache=True)
def neighbours(
    own: int, bodies: Array, xs: Array, ys: Array, headings: Array, reach: float
) -> tuple[int, int]:
    """Nearest bodies ahead of and behind a body along a path.

    Args:
        own: row of the body.
        bodies: all bodies, [M, 10].
        xs, ys, headings: the path.
        reach: lateral distance up to which a body counts as being on the path [m].

    Returns:
        Rows of the leader and of the follower; -1 where there is none within 80 m.
    """
    s, _ = project(bodies[own, X], bodies[own, Y], xs, ys, headings)
    front, rear = -1, -1
    front_s, rear_s = s + 80.0, s - 80.0
    for k in range(bodies.shape[0]):
        if k == own:
            continue
        dx, dy = bodies[k, X] - bodies[own, X], bodies[k, Y] - bodies[own, Y]
        if dx * dx + dy * dy > 6400.0:
            continue
        other_s, other_d = project(bodies[k, X], bodies[k, Y], xs, ys, headings)
        if abs(other_d) > reach + bodies[k, HALF_WIDTH] - 1.0 or other_s < 0:
            continue
        if s < other_s < front_s:
            front, front_s = k, other_s
        elif rear_s < other_s <= s:
            rear, rear_s = k, other_s
    return front, rear


@njit(cache=True)
def locate(bodies: Array, xs: Array, ys: Array, headings: Array, starts: np.ndarray) -> None:
    """Fill in each body's arc length and offset on the path it drives (paths as in `predict`)."""
    for m in range(bodies.shape[0]):
        p = int(bodies[m, PATH])
        if p >= 0:
            a, b = starts[p], starts[p + 1]
            bodies[m, S], bodies[m, D] = project(
                bodies[m, X], bodies[m, Y], xs[a:b], ys[a:b], headings[a:b]
            )


@njit(cache=True)
def along(bodies: Array, xs: Array, ys: Array, headings: Array) -> tuple[Array, Array]:
    """Arc lengths and offsets [m] of all bodies on one path, both [M]."""
    s, d = np.empty(bodies.shape[0]), np.empty(bodies.shape[0])
    for m in range(bodies.shape[0]):
        s[m], d[m] = project(bodies[m, X], bodies[m, Y], xs, ys, headings)
    return s, d


@njit(cache=True)
def overlaps(
    x: float, y: float, heading: float, half_length: float, half_width: float,
    ox: float, oy: float, other_heading: float, other_length: float, other_width: float,
) -> bool:  # fmt: skip
    """Whether two oriented boxes overlap (separating axes); extents are halves [m]."""
    dx, dy = ox - x, oy - y
    reach = half_length + half_width + other_length + other_width
    if dx * dx + dy * dy > reach * reach:
        return False
    cos, sin = np.cos(heading), np.sin(heading)
    other_cos, other_sin = np.cos(other_heading), np.sin(other_heading)
    c = abs(cos * other_cos + sin * other_sin)
    s = abs(cos * other_sin - sin * other_cos)
    if abs(cos * dx + sin * dy) > half_length + other_length * c + other_width * s:
        return False
    if abs(-sin * dx + cos * dy) > half_width + other_length * s + other_width * c:
        return False
    if abs(other_cos * dx + other_sin * dy) > other_length + half_length * c + half_width * s:
        return False
    return bool(
        abs(-other_sin * dx + other_cos * dy) <= other_width + half_length * s + half_width * c
    )


@njit(cache=True)
def touching(bodies: Array) -> np.ndarray:
    """Rows of the bodies, [M, 10], that overlap the first one."""
    hits = np.zeros(bodies.shape[0], dtype=np.bool_)
    for m in range(1, bodies.shape[0]):
        hits[m] = overlaps(
            bodies[0, X], bodies[0, Y], bodies[0, HEADING],
            bodies[0, HALF_LENGTH], bodies[0, HALF_WIDTH],
            bodies[m, X], bodies[m, Y], bodies[m, HEADING],
            bodies[m, HALF_LENGTH], bodies[m, HALF_WIDTH],
        )  # fmt: skip
    return np.flatnonzero(hits)


@njit(cache=True)
def predict(
    bodies: Array, xs: Array, ys: Array, headings: Array, starts: np.ndarray, steps: int, dt: float,
    surge: float = 0.0, drift: float = 0.0,
) -> Array:  # fmt: skip
    """Where every body will be if it keeps to its path.

    A body keeps its speed, or goes on braking as it does now, and comes back to the middle of its
    path within two seconds. A body without a path (PATH < 0) stays on its line and keeps its speed.

    Args:
        bodies: [M, 10].
        xs, ys, headings: samples of all paths, one after the other; path p is
            ``starts[p]:starts[p + 1]``.
        steps, dt: number of instants and time between them [s].
        surge: for how long a body that accelerates goes on doing so [s].
        drift: for how long a body that leaves the middle of its path goes on doing so [s].

    Returns:
        Poses at dt, 2 dt, ...: [steps, M, 3] (x, y [m], heading [rad]).
    """
    count = bodies.shape[0]
    poses = np.empty((steps, count, 3))
    for m in range(count):
        speed, braking = bodies[m, SPEED], min(bodies[m, ACCELERATION], 0.0)
        push = max(bodies[m, ACCELERATION], 0.0)
        p = int(bodies[m, PATH])
        for k in range(steps):
            t = (k + 1) * dt
            if braking < -0.3:
                t_brake = min(t, -speed / braking)
                distance = speed * t_brake + 0.5 * braking * t_brake * t_brake
            else:
                pushed = min(t, surge)
                distance = speed * t + push * pushed * (t - 0.5 * pushed)
            if p < 0:
                poses[k, m, 0] = bodies[m, X] + distance * np.cos(bodies[m, HEADING])
                poses[k, m, 1] = bodies[m, Y] + distance * np.sin(bodies[m, HEADING])
                poses[k, m, 2] = bodies[m, HEADING]
            else:
                a, b = starts[p], starts[p + 1]
                d = bodies[m, D] * max(0.0, 1.0 - t / 2.0)
                if drift > 0.0:
                    _, _, along_path = interpolate(
                        bodies[m, S], 0.0, xs[a:b], ys[a:b], headings[a:b]
                    )
                    sideways = speed * np.sin(bodies[m, HEADING] - along_path)
                    if sideways * bodies[m, D] > 0.0:
                        d = bodies[m, D] + sideways * min(t, drift)
                x, y, heading = interpolate(
                    bodies[m, S] + distance, d, xs[a:b], ys[a:b], headings[a:b]
                )
                poses[k, m, 0], poses[k, m, 1], poses[k, m, 2] = x, y, heading
    return poses


@njit(cache=True)
def cast_rays(
    x: float, y: float, heading: float, speed: float, bodies: Array, count: int, reach: float
) -> tuple[Array, Array]:
    """Distances to bodies along rays around a vehicle, as a lidar sees them.

    Ray 0 points ahead, the others follow clockwise (to the right first) in equal steps. Each body
    is drawn into the rays of the angle it spans, so the cost grows with what is near.

    Args:
        x, y, heading, speed: the vehicle [m, m, rad, m/s].
        bodies: the other bodies, [M, 10].
        count: number of rays.
        reach: range [m].

    Returns:
        Distances [m], `reach` where nothing is hit, and the rate at which each distance changes
        because of the two vehicles' motion [m/s] (negative: closing in), 0 where nothing is hit;
        both of shape [count].
    """
    distances = np.full(count, reach)
    rates = np.zeros(count)
    step = 2 * np.pi / count
    vx, vy = speed * np.cos(heading), speed * np.sin(heading)
    for m in range(bodies.shape[0]):
        dx, dy = bodies[m, X] - x, bodies[m, Y] - y
        length, width = bodies[m, HALF_LENGTH], bodies[m, HALF_WIDTH]
        far = np.hypot(dx, dy)
        radius = np.hypot(length, width)
        if far - radius > reach:
            continue
        cos, sin = np.cos(bodies[m, HEADING]), np.sin(bodies[m, HEADING])
        # The vehicle in the frame of the box.
        px, py = -(cos * dx + sin * dy), -(-sin * dx + cos * dy)
        spread = np.pi if far <= radius else np.arcsin(radius / far)
        bearing = np.arctan2(dy, dx) - heading
        first = int(np.ceil((bearing - spread) / step))
        last = int(np.floor((bearing + spread) / step))
        ovx, ovy = bodies[m, SPEED] * cos, bodies[m, SPEED] * sin
        for ray in range(first, last + 1):
            angle = heading + ray * step
            ux, uy = np.cos(angle), np.sin(angle)
            bx, by = cos * ux + sin * uy, -sin * ux + cos * uy
            near, away = 0.0, reach
            if abs(bx) < 1e-9:
                if abs(px) > length:
                    continue
            else:
                t1, t2 = (-length - px) / bx, (length - px) / bx
                near, away = max(near, min(t1, t2)), min(away, max(t1, t2))
            if abs(by) < 1e-9:
                if abs(py) > width:
                    continue
            else:
                t1, t2 = (-width - py) / by, (width - py) / by
                near, away = max(near, min(t1, t2)), min(away, max(t1, t2))
            k = ray % count
            if near <= away and near < distances[k]:
                distances[k] = near
                rates[k] = (ovx - vx) * ux + (ovy - vy) * uy
    return distances, rates
