"""N human-driven followers that really follow the AV, on the trail it leaves.

Followers that look for their leader by lane lose the AV in turns and lane changes; on the trail
they keep it. Each drives by IDM with the paper's parameters behind its predecessor, or behind
whatever else stands on the trail before it.
"""

from __future__ import annotations

import numpy as np

from haim_torchrl.envs.geometry import HALF_LENGTH, HALF_WIDTH, SPEED, X, Y
from haim_torchrl.envs.path import Array, Path, interpolate, project
from haim_torchrl.envs.vehicles import FollowerVehicle
from haim_torchrl.traffic.car_following import IDMParameters
from haim_torchrl.traffic.kernels import idm_acceleration_scalar, idm_constants

CAPACITY = 4096


class Platoon:
    """The followers of one episode.

    Args:
        run_up: the path up to the AV's start; the followers stand on it.
        count: number of followers N.
        gap: initial bumper-to-bumper gaps [m].
        speed: initial speed [m/s].
        params: the drivers' IDM parameters.

    Attributes:
        gaps: gaps to the predecessor (the AV for the first) [m], shape [N].
        speeds: speeds [m/s], shape [N].
        accelerations: accelerations over the last step [m/s²], shape [N].
        vehicles: the followers as highway-env vehicles.
    """

    def __init__(
        self, run_up: Path, count: int, gap: float, speed: float, params: IDMParameters
    ) -> None:
        self._samples = np.zeros((3, CAPACITY))
        self._used = len(run_up.x)
        self._samples[:, : self._used] = run_up.x, run_up.y, run_up.heading
        self.trail_length = run_up.length
        self._last = np.array([run_up.x[-1], run_up.y[-1]])
        self._constants = idm_constants(params)
        self._max_speed = params.desired_speed
        length = FollowerVehicle.LENGTH
        self._s = self.trail_length - (gap + length) * np.arange(1, count + 1)
        self.gaps = np.full(count, gap)
        self.speeds = np.full(count, speed)
        self.accelerations = np.zeros(count)
        self.vehicles = [
            FollowerVehicle(None, np.zeros(2), 0.0, speed) for _ in range(count)
        ]
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
        length = FollowerVehicle.LENGTH
        blockers = self._on_trail(others)
        lead_s, lead_speed, before = self.trail_length, speed, self.speeds.copy()
        for i in range(len(self._s)):
            gap, ahead_speed = lead_s - self._s[i] - length, lead_speed
            for s, half, other_speed in blockers:
                other_gap = s - half - self._s[i] - length / 2
                if self._s[i] < s and other_gap < gap:
                    gap, ahead_speed = other_gap, other_speed
            acceleration = idm_acceleration_scalar(before[i], gap, ahead_speed, self._constants)
            new = min(max(before[i] + acceleration * dt, 0.0), self._max_speed)
            lead_s, lead_speed = self._s[i], before[i]
            self._s[i] += min((before[i] + new) / 2 * dt, max(gap, 0.0))
            self.speeds[i] = new
        self.accelerations = (self.speeds - before) / dt
        self.gaps = np.concatenate([[self.trail_length], self._s[:-1]]) - self._s - length
        self._place()

    def _extend(self, position: Array) -> None:
        travelled = position - self._last
        distance = float(np.hypot(*travelled))
        if distance < 1e-6:
            return
        heading = float(np.arctan2(travelled[1], travelled[0]))
        previous = self._samples[2, self._used - 1]
        heading = previous + (heading - previous + np.pi) % (2 * np.pi) - np.pi
        before = self.trail_length
        self.trail_length += distance
        while self._used <= self.trail_length and self._used < CAPACITY:
            share = (self._used - before) / distance
            self._samples[:2, self._used] = self._last + share * travelled
            self._samples[2, self._used] = heading
            self._used += 1
        self._last = position.copy()

    def _on_trail(self, others: Array) -> list[tuple[float, float, float]]:
        first = max(int(self._s[-1]) - 10, 0)
        xs, ys, headings = self._samples[:, first : self._used]
        found = []
        for body in others:
            if (body[X] - self._last[0]) ** 2 + (body[Y] - self._last[1]) ** 2 > 150.0**2:
                continue
            s, d = project(body[X], body[Y], xs, ys, headings)
            if abs(d) < 1.0 + body[HALF_WIDTH] and 0 < s < self._used - first:
                found.append((s + first, body[HALF_LENGTH], body[SPEED]))
        return found

    def _place(self) -> None:
        xs, ys, headings = self._samples[:, : self._used]
        for vehicle, s, speed in zip(self.vehicles, self._s, self.speeds, strict=True):
            x, y, heading = interpolate(s, 0.0, xs, ys, headings)
            vehicle.position = np.array([x, y])
            vehicle.heading, vehicle.speed = heading, float(speed)
