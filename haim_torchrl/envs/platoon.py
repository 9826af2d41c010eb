"""N human-driven followers that really follow the AV, on the trail it leaves.

Followers that look for their leader by lane lose the AV in turns and lane changes; on the trail
they keep it. Each drives by IDM with the paper's parameters behind its predecessor, or behind
whatever else stands on the trail before it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from haim_torchrl.envs.geometry import HALF_LENGTH, HALF_WIDTH, SPEED, X, Y
from haim_torchrl.envs.path import Array, Path, interpolate, project
from haim_torchrl.envs.vehicles import FollowerVehicle
from haim_torchrl.traffic.car_following import IDMParameters
from haim_torchrl.traffic.kernels import IDMConstants, idm_acceleration_scalar, idm_constants

CAPACITY = 2048
"""Samples of trail that are allocated at once."""


class Platoon:
    """The followers of one episode.

    Args:
        run_up: the path up to the AV's start; the followers stand on it.
        count: number of followers N.
        gap: initial bumper-to-bumper gaps [m].
        speed: initial speed [m/s].
        params: the drivers' IDM parameters.
        length: of the AV and each follower [m].

    Attributes:
        gaps: gaps to the predecessor (the AV for the first) [m], shape [N].
        speeds: speeds [m/s], shape [N].
        accelerations: accelerations over the last step [m/s²], shape [N].
        poses: centres and headings [m, m, rad], shape [N, 3].
        vehicles: the followers as highway-env vehicles.
        trail_length: arc length of the trail up to the AV [m].
    """

    def __init__(
        self,
        run_up: Path,
        count: int,
        gap: float,
        speed: float,
        params: IDMParameters,
        length: float = FollowerVehicle.LENGTH,
    ) -> None:
        self._used = len(run_up.x)
        self._samples = np.zeros((3, self._used + CAPACITY))
        self._samples[:, : self._used] = run_up.x, run_up.y, run_up.heading
        self.trail_length = run_up.length
        self._last = np.array([run_up.x[-1], run_up.y[-1]])
        self._constants = idm_constants(params)
        self._max_speed = params.desired_speed
        self._length = length
        self._s: Array = self.trail_length - (gap + length) * np.arange(1.0, count + 1)
        self.gaps = np.full(count, gap, dtype=float)
        self.speeds = np.full(count, speed, dtype=float)
        self.accelerations = np.zeros(count)
        self.poses = np.zeros((count, 3))
        self.vehicles = [FollowerVehicle(None, np.zeros(2), 0.0, speed) for _ in range(count)]
        self._place()

    def step(self, position: Array, speed: float, others: Array, dt: float) -> None:
        """Follow the AV to its new position.

        Args:
            position: the AV's centre [m, m].
            speed: its speed [m/s].
            others: bodies of the other traffic, [M, 10].
            dt: time step [s].
        """
        self._extend(position)
        if not len(self._s):
            return
        before = self.speeds.copy()
        first = max(int(self._s[-1]) - 10, 0)
        xs, ys, headings = self._samples[:, first : self._used]
        found = blockers(others, xs, ys, headings)
        found[:, 0] += first
        follow(
            self._s, self.speeds, self.trail_length, speed, found, self._length, dt,
            self._max_speed, self._constants,
        )  # fmt: skip
        self.accelerations = (self.speeds - before) / dt
        self.gaps[0] = self.trail_length - self._s[0] - self._length
        self.gaps[1:] = self._s[:-1] - self._s[1:] - self._length
        self._place()

    def _extend(self, position: Array) -> None:
        travelled = position - self._last
        distance = float(np.hypot(*travelled))
        if distance < 1e-6:
            return
        previous = self._samples[2, self._used - 1]
        turn = float(np.arctan2(travelled[1], travelled[0])) - previous
        before = self.trail_length
        self.trail_length += distance
        if self.trail_length >= self._samples.shape[1]:
            self._samples = np.pad(self._samples, ((0, 0), (0, CAPACITY)))
        while self._used <= self.trail_length:
            share = (self._used - before) / distance
            self._samples[:2, self._used] = self._last + share * travelled
            self._samples[2, self._used] = previous + (turn + np.pi) % (2 * np.pi) - np.pi
            self._used += 1
        self._last = position.copy()

    def _place(self) -> None:
        xs, ys, headings = self._samples[:, : self._used]
        for k, vehicle in enumerate(self.vehicles):
            self.poses[k] = interpolate(self._s[k], 0.0, xs, ys, headings)
            vehicle.position = self.poses[k, :2].copy()
            vehicle.heading, vehicle.speed = float(self.poses[k, 2]), float(self.speeds[k])


@njit(cache=True)
def blockers(others: Array, xs: Array, ys: Array, headings: Array) -> Array:
    """Bodies that stand on a trail.

    Args:
        others: the bodies, [M, 10].
        xs, ys, headings: the trail up to the AV.

    Returns:
        Arc length, half length [m] and speed [m/s] of each, [K, 3].
    """
    found = np.empty((others.shape[0], 3))
    count = 0
    for m in range(others.shape[0]):
        s, d = project(others[m, X], others[m, Y], xs, ys, headings)
        if abs(d) < 1.0 + others[m, HALF_WIDTH] and 0 < s < xs.shape[0]:
            found[count] = s, others[m, HALF_LENGTH], others[m, SPEED]
            count += 1
    return found[:count]


@njit(cache=True)
def follow(
    s: Array, speeds: Array, lead_s: float, lead_speed: float, others: Array,
    length: float, dt: float, max_speed: float, constants: IDMConstants,
) -> None:  # fmt: skip
    """Move the followers by one time step, in place.

    Args:
        s, speeds: their arc lengths on the trail [m] and speeds [m/s], both [N].
        lead_s, lead_speed: the AV's [m, m/s].
        others: who else stands on the trail (see :func:`blockers`), [K, 3].
        length: of the AV and each follower [m].
        dt: time step [s].
        max_speed: limit of the speeds [m/s].
        constants: the drivers' IDM parameters.
    """
    for i in range(s.shape[0]):
        here, speed = s[i], speeds[i]
        gap, ahead_speed = lead_s - here - length, lead_speed
        for k in range(others.shape[0]):
            other_gap = others[k, 0] - others[k, 1] - here - length / 2
            if here < others[k, 0] and other_gap < gap:
                gap, ahead_speed = other_gap, others[k, 2]
        acceleration = idm_acceleration_scalar(speed, gap, ahead_speed, constants)
        new = min(max(speed + acceleration * dt, 0.0), max_speed)
        lead_s, lead_speed = here, speed
        # Never farther than the gap: a follower may touch who stops dead, not drive into it.
        s[i] += min((speed + new) / 2 * dt, max(gap, 0.0))
        speeds[i] = new
