"""The X+1+N world as a highway-env environment, registered as ``haim_torchrl/Platoon-v0``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.vehicle.objects import RoadObject

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.envs.blocks import LANE_WIDTH, lane_offset
from haim_torchrl.envs.config import PlatoonConfig
from haim_torchrl.envs.forecast import StallCounter, forecast
from haim_torchrl.envs.geometry import HALF_LENGTH, HALF_WIDTH, HEADING, X, Y
from haim_torchrl.envs.observation import observe
from haim_torchrl.envs.path import Path
from haim_torchrl.envs.platoon import Platoon
from haim_torchrl.envs.road import PlatoonRoad
from haim_torchrl.envs.scenario import START, generate_scenario
from haim_torchrl.envs.semantic import RoadLayers, SemanticConfig, SemanticObserver, band
from haim_torchrl.envs.vehicles import AutomatedVehicle, TrafficVehicle, command
from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.switches.protocol import Forecast

TIME_STEP = 0.1
"""Duration of a step [s]."""
ARRIVAL = 8.0
"""The destination is this far before the end of the route [m]."""
RENDERING = (
    *("screen_width", "screen_height", "scaling", "centering_position"),
    *("show_trajectories", "offscreen_rendering", "real_time_rendering"),
)
"""highway-env's settings that have a meaning here."""
CRUISE = 11.1
"""Speed on a free straight road [m/s]: 40 km/h, the paper's limit."""


class PlatoonEnv(AbstractEnv):
    """One AV with N followers on a random road with traffic and obstacles (X+1+N).

    Actions: (acceleration, steering) in [-1, 1]², see
    :class:`~haim_torchrl.envs.vehicles.AutomatedVehicle`. Observation: a float32 vector, see
    :func:`~haim_torchrl.envs.observation.observe`, or an image and the speed, see
    :class:`~haim_torchrl.envs.semantic.SemanticObserver`. ``reset(seed=k)`` makes scenario k;
    without a seed a scenario of the configured set is drawn. Reward (progress, speed, +20 at the
    destination) and cost (+1 a collision) exist for evaluation and baselines only.

    Args:
        config: settings by name, see :class:`PlatoonConfig`; highway-env's own rendering settings
            may be among them.
        render_mode: None or "rgb_array".
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}
    road: PlatoonRoad
    observation_space: spaces.Space

    def __init__(self, config: Mapping[str, Any] | None = None, render_mode: str | None = None):
        given = dict(config or {})
        rendering = {key: given.pop(key) for key in RENDERING if key in given}
        self.settings = PlatoonConfig.of(given)
        super().__init__(rendering, render_mode)

    @classmethod
    def default_config(cls) -> dict:
        config = super().default_config()
        config.update(
            screen_width=900, screen_height=450, scaling=4.0, centering_position=[0.5, 0.5]
        )
        return config

    def define_spaces(self) -> None:
        seen = self.settings.observation
        self.eyes = SemanticObserver(seen) if isinstance(seen, SemanticConfig) else None
        if self.eyes is None:
            self.observation_space = spaces.Box(-np.inf, np.inf, (seen.size,), np.float32)
        else:
            self.observation_space = self.eyes.space
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def followers(self) -> int:
        """Number N of followers."""
        return self.settings.followers

    @property
    def minimum_acceleration(self) -> float:
        """Strongest braking of the AV [m/s²], negative."""
        return command(np.array([-1.0, 0.0]))["acceleration"]

    @property
    def stalled(self) -> int:
        """Steps lost so far by driving slowly without cause."""
        return self._stall.steps

    @property
    def reflection(self) -> Reflection | None:
        """What a mirror does to observations and actions; None if the strips are lopsided."""
        if isinstance(self.settings.observation, SemanticConfig):
            return SemanticObserver(self.settings.observation).reflection
        mirrored = self.settings.observation.reflection
        return None if mirrored is None else Reflection(*mirrored, action_sign=(1.0, -1.0))

    # Episodes.
    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[np.ndarray, dict]:
        """Start scenario `seed`, or one drawn from the configured set."""
        if seed is not None or self._np_random is None:
            super(AbstractEnv, self).reset(seed=seed)
        settings = self.settings
        if seed is None:
            seed = settings.first_scenario + int(self.np_random.integers(settings.scenarios))
        self.scenario = generate_scenario(int(seed), settings.scenario)
        lane = int(np.random.default_rng([seed, 1]).integers(self.scenario.lanes))
        lane_d = lane_offset(lane, self.scenario.lanes)
        x, y, heading = self.scenario.route.at(START, lane_d)
        av = AutomatedVehicle(None, np.array([x, y]), heading, settings.initial_speed)
        platoon = Platoon(
            self.scenario.route.shifted(lane_d).part(0, START),
            settings.followers,
            settings.follower_gap,
            settings.initial_speed,
            settings.idm,
        )
        self.controlled_vehicles = [av]
        self.road = PlatoonRoad(self.scenario, av, platoon, np.random.RandomState(seed % 2**32))
        self.time, self.steps = 0.0, 0
        self.done = False
        self.acceleration, self.distance = 0.0, 0.0
        self._stall = StallCounter(settings.initial_speed)
        self._progress_before = float(self.road.route_s[0])
        self._events = dict.fromkeys(("crash", "out_of_road", "wrong_way", "success"), False)
        self._cost = 0.0
        self._touching: set[RoadObject] = set()
        if self.eyes is not None:
            self.eyes.reset(self.road_layers())
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Drive one step of 0.1 s."""
        av, dt = self.vehicle, TIME_STEP
        before, position = av.speed, av.position.copy()
        av.drive(action)
        self.road.act()
        self.road.step(dt)
        self.steps += 1
        self.time += dt
        self.distance += float(np.hypot(*(av.position - position)))
        self._judge()
        # A crash stops the car, but says nothing about how it was braked.
        self.acceleration = 0.0 if self._events["crash"] else (av.speed - before) / dt
        self._count_stall()
        reward = self._reward()
        terminated = self._is_terminated()
        truncated = self._is_truncated() and not terminated
        if self.render_mode == "human":
            self.render()
        return self._observe(), reward, terminated, truncated, self._info()

    def _judge(self) -> None:
        road, av = self.road, self.vehicle
        s, d = float(road.route_s[0]), float(road.route_d[0])
        error = av.heading - self.scenario.route.at(s)[2]
        touched = {road.things[row]: row for row in road.collision_partners()}
        # A collision is an event: what the AV still touches from the last step is not a new one.
        hit = [row for thing, row in touched.items() if thing not in self._touching]
        self._touching = set(touched)
        crash = bool(hit)
        if hit and not self.settings.end_on_collision:
            road.remove(hit)
        out = abs(d) > self.scenario.half_width
        wrong = bool(np.cos(error) < 0.0)
        arrived = s >= self.scenario.route.length - ARRIVAL
        self._cost = float(len(hit))
        self._events = {
            "crash": crash,
            "out_of_road": out,
            "wrong_way": wrong,
            "success": arrived and not (out or wrong or crash),
        }

    def _count_stall(self) -> None:
        """Count steps of driving slowly, getting no faster, with nothing in the way."""
        av, road = self.vehicle, self.road
        lane = road.network.get_lane(av.lane_index)
        s, _ = lane.local_coordinates(av.position)
        slow = self.settings.stall_speed * min(CRUISE, lane.speed_at(s))
        self._stall.update(av.speed, slow, av.speed <= slow and self._is_held_up(slow))

    def _is_held_up(self, slow: float) -> bool:
        av, road = self.vehicle, self.road
        front, _ = road.neighbour_vehicles(av)
        if front is not None and 0.5 < front.speed < slow + 1.0:
            near = 12.0 + 1.5 * av.speed
            if np.hypot(*(front.position - av.position)) < near:
                return True
        return any(
            isinstance(v, TrafficVehicle)
            and v.spawn.side is not None
            and v.speed > 0.5
            and np.hypot(*(v.position - av.position)) < 40.0
            for v in road.vehicles
        )

    def _observe(self) -> Any:
        if isinstance(self.settings.observation, SemanticConfig):
            assert self.eyes is not None
            return self.eyes.observe(self.snapshot())
        return observe(self.road, self.settings.observation)

    def _reward(self, action: Any = None) -> float:
        s = float(self.road.route_s[0])
        moved, self._progress_before = s - self._progress_before, s
        reward = moved + 0.1 * self.vehicle.speed / AutomatedVehicle.MAX_SPEED
        return float(reward + 20.0 * self._events["success"])

    def _is_terminated(self) -> bool:
        events = self._events
        ended = events["out_of_road"] or events["wrong_way"] or events["success"]
        return bool(ended or (events["crash"] and self.settings.end_on_collision))

    def _is_truncated(self) -> bool:
        return self.steps >= self.settings.horizon

    def _info(self, obs: Any = None, action: Any = None) -> dict[str, Any]:
        span = self.scenario.route.length - ARRIVAL - START
        return {
            "speed": self.vehicle.speed,
            "acceleration": self.acceleration,
            "follower_gaps": self.road.platoon.gaps.astype(np.float32),
            "follower_speeds": self.road.platoon.speeds.astype(np.float32),
            "progress": float(np.clip((self.road.route_s[0] - START) / span, 0.0, 1.0)),
            "cost": self._cost,
            **self._events,
        }

    # What switches, mentors and recorders ask.
    def forecast(self, action: np.ndarray) -> Forecast:
        """Where the action leads if it is held for a moment and the AV then brakes."""
        settings, wanted = self.settings, command(action)
        return forecast(
            self.road,
            wanted["acceleration"],
            wanted["steering"],
            hold=settings.forecast_hold,
            braking=settings.forecast_braking,
            road_margin=settings.forecast_road_margin,
            gap_margin=settings.forecast_gap_margin,
            stalled_steps=self.stalled,
        )

    def snapshot(self) -> Snapshot:
        """The scene now, for recordings."""
        road, platoon = self.road, self.road.platoon
        # highway-env's y axis points to the right of the road, that of recordings to the left.
        boxes = road.bodies[:, [X, Y, HEADING, HALF_LENGTH, HALF_WIDTH]] * [1, -1, -1, 2, 2]
        first = 1 + road.followers
        others = [*road.vehicles[first:], *road.objects]
        moving = np.array([isinstance(thing, TrafficVehicle) for thing in others], dtype=bool)
        return Snapshot(
            time=self.time,
            vehicle=boxes[0],
            speed=self.vehicle.speed,
            acceleration=self.acceleration,
            followers=boxes[1:first],
            follower_speeds=platoon.speeds.copy(),
            follower_accelerations=platoon.accelerations.copy(),
            follower_gaps=platoon.gaps.copy(),
            traffic=boxes[first:][moving],
            obstacles=boxes[first:][~moving],
            distance=self.distance,
        )

    def road_polylines(self) -> list[RoadLine]:
        """Edges, markings, side roads and the route of the present scenario."""
        scenario = self.scenario
        lines = []
        for k in range(scenario.lanes + 1):
            path = scenario.route.shifted(k * LANE_WIDTH - scenario.half_width)
            edge = k in (0, scenario.lanes)
            lines.append(RoadLine(_points(path), edge=edge))
        for side in scenario.sides:
            surface = side.path.part(*side.surface)
            for d in (-LANE_WIDTH / 2, LANE_WIDTH / 2):
                path = surface.shifted(d)
                lines.append(RoadLine(_points(path), edge=False))
        route = scenario.route
        lines.append(RoadLine(_points(route), edge=False, route=True))
        return lines

    def road_layers(self) -> RoadLayers:
        """Surfaces, lines and the route's carriageway of the present scenario, for images."""
        scenario = self.scenario
        carriageway = band(_points(scenario.route), 2 * scenario.half_width)
        sides = [side.path.part(*side.surface) for side in scenario.sides]
        return RoadLayers(
            surfaces=[*carriageway, *(p for s in sides for p in band(_points(s), LANE_WIDTH))],
            lines=[line.points for line in self.road_polylines() if not line.route],
            route=carriageway,
        )

    def scenario_labels(self) -> ScenarioLabels:
        """Seed, block types and number of obstacles."""
        scenario = self.scenario
        kinds = tuple(kind for kind, _, _ in scenario.blocks)
        return ScenarioLabels(scenario.seed, kinds, len(scenario.obstacles))


def _points(path: Path) -> np.ndarray:
    """A path's points in the frame of recordings, whose y axis points to the left, [P, 2]."""
    return np.stack([path.x, -path.y], 1)
