"""A rule-based expert driver with access to the simulator: the mentor of default runs.

It follows its lane by pure pursuit and its leader by IDM, slows down for bends, picks the lane
that lets it go on fastest, and checks every choice against where the others will be in the next
four seconds; where the smooth choice is not free it brakes as gently as is. A smooth mentor can be
imitated; one that jumps between sampled accelerations teaches noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.envs import geometry
from haim_torchrl.envs.blocks import lane_offset
from haim_torchrl.envs.geometry import HALF_LENGTH, PATH, SPEED, X, Y
from haim_torchrl.envs.planning import look_ahead, pursue
from haim_torchrl.envs.road import PREDICTION_STEP, REACH, PlatoonRoad
from haim_torchrl.envs.vehicles import BRAKING, STEERING, THROTTLE, AutomatedVehicle

BRAKES = (-1.0, -2.0, -3.0, -4.5, -6.0, -8.0)


@dataclass
class ExpertMentor:
    """The expert driver.

    Attributes:
        speed: desired speed [m/s]; 40 km/h, the paper's limit.
        headway: time headway behind a leader [s].
        gap: standstill gap behind a leader [m].
        lane_gain: how much faster another lane must be to change to it [m/s].
        comfort: comfortable acceleration and deceleration [m/s²].
    """

    speed: float = 11.1
    headway: float = 1.2
    gap: float = 4.0
    still_gap: float = 8.0
    lane_gain: float = 1.5
    comfort: float = 2.0

    def __post_init__(self) -> None:
        self._lane = 0

    def reset(self, simulator: Any) -> None:
        """Start in the lane that the vehicle is in."""
        self._lane = simulator.road.av.lane_index[2]
        self._settled = True

    def act(self, simulator: Any, tensordict: TensorDictBase | None = None) -> Tensor:
        """The expert's action, [2] in [-1, 1]: acceleration, steering."""
        road: PlatoonRoad = simulator.road
        av = road.av
        here = av.lane_index[2]
        if abs(self._lane - here) > 1:
            self._lane = here  # somebody else has driven since
        options = {}
        for lane in {self._lane, here - 1, here, here + 1}:
            if 0 <= lane < road.scenario.lanes:
                options[lane] = self._option(road, lane)
        lane = self._choose(road, options, here)
        self._lane = lane
        acceleration = options[lane][0]
        route = road.scenario.route
        steering = pursue(
            av.position[0], av.position[1], av.heading, av.speed,
            lane_offset(lane, road.scenario.lanes), route.x, route.y, route.heading, STEERING,
        )  # fmt: skip
        pedal = acceleration / (THROTTLE if acceleration > 0 else BRAKING)
        return torch.tensor([pedal, steering / STEERING], dtype=torch.float32).clamp(-1.0, 1.0)

    def _choose(self, road: PlatoonRoad, options: dict[int, tuple], here: int) -> int:
        scores = {}
        for lane, (acceleration, prospect, free, clear) in options.items():
            score = prospect
            if lane != self._lane:
                score -= self.lane_gain
                if not clear or acceleration < -2.5:
                    score -= 100.0
            if not free:
                score -= 50.0
            scores[lane] = score - 0.01 * abs(lane - here)
        return max(scores, key=lambda lane: scores[lane])

    def _option(self, road: PlatoonRoad, lane: int) -> tuple[float, float, bool, bool]:
        """Acceleration [m/s²], prospective speed [m/s], free of collisions, clear to change."""
        av, path = road.av, road.lanes[lane].path
        s, _ = path.project(av.position)
        front, rear = geometry.neighbours(0, road.bodies, path.x, path.y, path.heading, REACH)
        wanted = min(self.speed, road.lanes[lane].speed_at(s + 0.3 * av.speed))
        v = av.speed
        acceleration = self.comfort * (1 - (v / wanted) ** 4) if v <= wanted else max(
            -2.0 * (v - wanted), -4.0
        )
        prospect = self.speed
        if front >= 0:
            other = road.bodies[front]
            lead_s, _ = path.project((other[X], other[Y]))
            still = other[SPEED] < 0.5 and other[PATH] < road.scenario.lanes
            space = lead_s - s - AutomatedVehicle.LENGTH / 2 - other[HALF_LENGTH]
            minimum = self.still_gap if still else self.gap
            need = minimum + max(
                0.0, v * self.headway + v * (v - other[SPEED]) / (2 * self.comfort * 1.2)
            )
            follow = self.comfort * (1 - (v / max(wanted, 1.0)) ** 4 - (need / max(space, 0.5)) ** 2)
            acceleration = min(acceleration, follow)
            prospect = min(prospect, other[SPEED] + max(space - minimum, 0.0) / 6.0)
        acceleration = float(np.clip(acceleration, -BRAKING, THROTTLE))
        clear = True
        if rear >= 1 + road.followers:
            other = road.bodies[rear]
            rear_s, _ = path.project((other[X], other[Y]))
            space = s - rear_s - AutomatedVehicle.LENGTH / 2 - other[HALF_LENGTH]
            clear = bool(space > 1.5 + max(0.0, 2.0 * (other[SPEED] - v)))
        free = False
        for choice in (acceleration, *(b for b in BRAKES if b < acceleration - 0.3)):
            hit, left = self._trial(road, lane, choice)
            if not np.isfinite(hit) and not np.isfinite(left):
                acceleration, free = choice, True
                break
        else:
            acceleration = -BRAKING
        return acceleration, prospect, free, clear

    def _trial(self, road: PlatoonRoad, lane: int, acceleration: float) -> tuple[float, float]:
        av, route = road.av, road.scenario.route
        hit, left, _, _ = look_ahead(
            av.position[0], av.position[1], av.heading, av.speed,
            0.0, 0.0, 0.0, acceleration, lane_offset(lane, road.scenario.lanes),
            STEERING, max(self.speed, av.speed), 4.0,
            route.x, route.y, route.heading, road.scenario.half_width,
            road.others, road.predicted(), PREDICTION_STEP, 0.6, 0.25, 0.6,
        )  # fmt: skip
        return hit, left
