"""A rule-based expert driver with access to the simulator: the mentor of default runs.

It follows its lane by pure pursuit and its leader by IDM, slows down for bends, picks the lane
that lets it go on fastest, and checks every choice against where the others will be in the next
four seconds; where the smooth choice is not free it brakes as gently as is. A smooth mentor can be
imitated; one that jumps between sampled accelerations teaches noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from haim_torchrl.envs import geometry
from haim_torchrl.envs.carriageway import Surroundings
from haim_torchrl.envs.geometry import HALF_LENGTH, PATH, SPEED, X, Y
from haim_torchrl.envs.path import Array
from haim_torchrl.envs.planning import Manoeuvre, Margins, look_ahead, pursue
from haim_torchrl.envs.road import REACH

BRAKES = (-1.0, -2.0, -3.0, -4.5, -6.0, -8.0)
"""Decelerations that are tried in turn where the smooth choice is not free [m/s²]."""
MARGINS = Margins(road=0.0, ahead=0.6, beside=0.25, still=0.6)


class _Option(NamedTuple):
    """What driving in one lane is like.

    Attributes:
        acceleration: the gentlest that is safe, or full braking [m/s²].
        prospect: speed that the lane lets the vehicle have [m/s].
        free: whether the acceleration is safe.
        clear: whether the lane may be changed to without cutting in on anybody.
    """

    acceleration: float
    prospect: float
    free: bool
    clear: bool


@dataclass
class ExpertMentor:
    """The expert driver.

    Attributes:
        speed: desired speed [m/s]; 40 km/h, the paper's limit.
        headway: time headway behind a leader [s].
        gap: standstill gap behind a leader [m].
        still_gap: the same behind something that stands in the lane [m]; it leaves room to get by.
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
        self._lane = _lane(simulator.road)

    def act(self, simulator: Any, tensordict: TensorDictBase | None = None) -> Tensor:
        """The expert's action, [2] in [-1, 1]: acceleration, steering."""
        road: Surroundings = simulator.road
        av = road.av
        here = _lane(road)
        if abs(self._lane - here) > 1:
            self._lane = here  # somebody else has driven since
        options = {
            lane: self._option(road, lane)
            for lane in {self._lane, here - 1, here, here + 1}
            if 0 <= lane < road.scenario.lanes
        }
        self._lane = self._choose(options, here)
        route, model = road.scenario.route, av.model
        steering = pursue(
            av.position[0], av.position[1], av.heading, av.speed,
            road.scenario.lane_offset(self._lane),
            route.x, route.y, route.heading, model.steering, model.wheelbase,
        )  # fmt: skip
        action = model.action(options[self._lane].acceleration, steering)
        return torch.tensor(action, dtype=torch.float32).clamp(-1.0, 1.0)

    def _choose(self, options: dict[int, _Option], here: int) -> int:
        scores = {}
        for lane, option in options.items():
            score = option.prospect
            if lane != self._lane:
                score -= self.lane_gain
                if not option.clear or option.acceleration < -2.5:
                    score -= 100.0
            if not option.free:
                score -= 50.0
            scores[lane] = score - 0.01 * abs(lane - here)
        return max(scores, key=lambda lane: scores[lane])

    def _option(self, road: Surroundings, lane: int) -> _Option:
        av, path = road.av, road.lanes[lane].path
        s, _ = path.project(av.position)
        front, rear = geometry.neighbours(0, road.bodies, path.x, path.y, path.heading, REACH)
        wanted = min(self.speed, road.lanes[lane].speed_at(s + 0.3 * av.speed))
        acceleration, prospect = self._on_free_road(av.speed, wanted), self.speed
        if front >= 0:
            leader = road.bodies[front]
            lead_s, _ = path.project((leader[X], leader[Y]))
            space = lead_s - s - av.model.length / 2 - leader[HALF_LENGTH]
            still = leader[SPEED] < 0.5 and leader[PATH] < road.scenario.lanes
            gap = self.still_gap if still else self.gap
            acceleration = min(acceleration, self._behind(av.speed, wanted, leader, space, gap))
            prospect = min(prospect, leader[SPEED] + max(space - gap, 0.0) / 6.0)
        clear = True
        if rear > road.followers:
            other = road.bodies[rear]
            rear_s, _ = path.project((other[X], other[Y]))
            space = s - rear_s - av.model.length / 2 - other[HALF_LENGTH]
            clear = bool(space > 1.5 + max(0.0, 2.0 * (other[SPEED] - av.speed)))
        smooth = float(np.clip(acceleration, BRAKES[-1], av.model.throttle))
        for choice in (smooth, *(brake for brake in BRAKES if brake < smooth - 0.3)):
            if self._is_free(road, lane, choice):
                return _Option(choice, prospect, True, clear)
        return _Option(BRAKES[-1], prospect, False, clear)

    def _on_free_road(self, speed: float, wanted: float) -> float:
        if speed <= wanted:
            return self.comfort * (1 - (speed / wanted) ** 4)
        return max(-2.0 * (speed - wanted), -4.0)

    def _behind(
        self, speed: float, wanted: float, leader: Array, space: float, gap: float
    ) -> float:
        """IDM behind a leader (a body) that is `space` [m] ahead, with a standstill gap [m]."""
        closing = speed * (speed - leader[SPEED]) / (2 * self.comfort * 1.2)
        need = gap + max(0.0, speed * self.headway + closing)
        free_road, interaction = (speed / max(wanted, 1.0)) ** 4, (need / max(space, 0.5)) ** 2
        return self.comfort * (1 - free_road - interaction)

    def _is_free(self, road: Surroundings, lane: int, acceleration: float) -> bool:
        target_d = road.scenario.lane_offset(lane)
        fastest = max(self.speed, road.av.speed)
        manoeuvre = Manoeuvre(then=acceleration, target_d=target_d, max_speed=fastest)
        return look_ahead(road, manoeuvre, MARGINS).free


def _lane(road: Surroundings) -> int:
    """Lane of the route that the AV is in."""
    return road.scenario.lane_at(float(road.route_d[0]))
