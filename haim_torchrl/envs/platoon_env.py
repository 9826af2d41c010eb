"""The X+1+N world as a highway-env environment, registered as ``haim_torchrl/Platoon-v0``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np
from gymnasium import spaces
from highway_env.envs.common.abstract import AbstractEnv

from haim_torchrl.envs.blocks import LANE_WIDTH
from haim_torchrl.envs.observation import ObservationConfig, observe
from haim_torchrl.envs.planning import look_ahead
from haim_torchrl.envs.platoon import Platoon
from haim_torchrl.envs.road import PREDICTION_STEP, PlatoonRoad
from haim_torchrl.envs.scenario import START, ScenarioConfig, generate_scenario
from haim_torchrl.envs.vehicles import STEERING, AutomatedVehicle, TrafficVehicle, command
from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.switches.protocol import Forecast
from haim_torchrl.traffic.car_following import IDMParameters


@dataclass(frozen=True)
class PlatoonConfig:
    """Settings of the world.

    Attributes:
        first_scenario, scenarios: the set of seeds that resets without a seed draw from.
        followers: N.
        follower_gap: their initial bumper-to-bumper gaps [m].
        initial_speed: of the AV and its followers [m/s].
        horizon: steps until an episode is cut off.
        frequency: steps per second [Hz].
        end_on_collision: whether a collision ends the episode. Otherwise the vehicle or obstacle
            hit is removed, as if towed away, and the AV goes on.
        forecast_hold: how long the risk forecast holds the agent's action [s].
        forecast_braking: how hard it brakes afterwards [m/s²].
        forecast_road_margin: how far inside the road's edge the AV's centre has to stay in the
            forecast [m]; 1 m is half of the vehicle's width.
        forecast_gap_margin: distance to others that the forecast asks for, ahead and behind [m].
        stall_speed: slower than this without cause counts as stalling [m/s]. A policy that only
            has to avoid takeovers would otherwise learn to crawl.
        scenario: what scenarios are drawn from.
        observation: what the agent sees.
        idm: the followers' car-following parameters.
    """

    first_scenario: int = 0
    scenarios: int = 50
    followers: int = 5
    follower_gap: float = 15.0
    initial_speed: float = 0.0
    horizon: int = 1000
    frequency: int = 10
    end_on_collision: bool = True
    forecast_hold: float = 0.6
    forecast_braking: float = 5.0
    forecast_road_margin: float = 0.8
    forecast_gap_margin: float = 1.5
    stall_speed: float = 3.0
    scenario: ScenarioConfig = field(default_factory=ScenarioConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    idm: IDMParameters = field(default_factory=IDMParameters)

    def __post_init__(self) -> None:
        if self.scenarios < 1:
            raise ValueError(f"scenarios: must be at least 1, got {self.scenarios}")
        if not 0 <= self.followers <= 5:
            raise ValueError(f"followers: must be between 0 and 5, got {self.followers}")
        if self.horizon < 1 or self.frequency < 1:
            raise ValueError("horizon and frequency: must be at least 1")
        if not 0 <= self.initial_speed <= AutomatedVehicle.MAX_SPEED:
            raise ValueError(f"initial_speed: must be in [0, 15] m/s, got {self.initial_speed}")

    @classmethod
    def of(cls, settings: Mapping[str, Any] | None) -> PlatoonConfig:
        """Settings from a mapping; parts (scenario, observation, idm) may be mappings, too.

        Raises:
            ValueError: an unknown key.
        """
        parts = {"scenario": ScenarioConfig, "observation": ObservationConfig, "idm": IDMParameters}
        values = dict(settings or {})
        _check_names(values, cls, "env")
        for name, kind in parts.items():
            if isinstance(values.get(name), Mapping):
                part = {
                    key: tuple(value) if isinstance(value, list) else value
                    for key, value in values[name].items()
                }
                _check_names(part, kind, f"env.{name}")
                values[name] = kind(**part)
        return cls(**values)


def _check_names(values: Mapping[str, Any], kind: Any, where: str) -> None:
    known = {f.name for f in fields(kind)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ValueError(f"{where}: unknown setting {unknown[0]!r}; choose from {sorted(known)}")


class PlatoonEnv(AbstractEnv):
    """One AV with N followers on a random road with traffic and obstacles (X+1+N).

    Actions: (acceleration, steering) in [-1, 1]², see
    :class:`~haim_torchrl.envs.vehicles.AutomatedVehicle`. Observation: a float32 vector, see
    :func:`~haim_torchrl.envs.observation.observe`. ``reset(seed=k)`` makes scenario k; without a
    seed a scenario of the configured set is drawn. Reward (progress, speed, +20 at the
    destination) and cost (+1 a collision) exist for evaluation and baselines only.

    Args:
        config: settings by name, see :class:`PlatoonConfig`; highway-env's own rendering settings
            may be among them.
        render_mode: None or "rgb_array".
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 10}  # noqa: RUF012
    road: PlatoonRoad

    def __init__(self, config: Mapping[str, Any] | None = None, render_mode: str | None = None):
        drawing = set(super().default_config())
        given = dict(config or {})
        rendering = {key: given.pop(key) for key in list(given) if key in drawing}
        self.settings = PlatoonConfig.of(given)
        self._seed_drawn = False
        super().__init__(rendering, render_mode)

    @classmethod
    def default_config(cls) -> dict:
        config = super().default_config()
        config.update(
            screen_width=900, screen_height=450, scaling=4.0, centering_position=[0.5, 0.5]
        )
        return config

    def define_spaces(self) -> None:
        size = self.settings.observation.size
        self.observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def minimum_acceleration(self) -> float:
        """Strongest braking of the AV [m/s²], negative."""
        return command(np.array([-1.0, 0.0]))["acceleration"]

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
        lane = int(np.random.default_rng(seed).integers(self.scenario.lanes))
        lane_d = (lane - (self.scenario.lanes - 1) / 2) * LANE_WIDTH
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
        self.time = self.steps = 0
        self.done = False
        self.acceleration, self.distance, self.stalled = 0.0, 0.0, 0
        self._progress_before = float(self.road.route_s[0])
        self._events = dict.fromkeys(("crash", "out_of_road", "wrong_way", "success"), False)
        self._cost = 0.0
        if self.render_mode == "human":
            self.render()
        return self._observe(), self._info(None)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Drive one step of 0.1 s."""
        av, dt = self.vehicle, 1.0 / self.settings.frequency
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
        reward = self._reward(action)
        terminated = self._is_terminated()
        truncated = self._is_truncated() and not terminated
        if self.render_mode == "human":
            self.render()
        return self._observe(), reward, terminated, truncated, self._info(action)

    def _judge(self) -> None:
        road, av = self.road, self.vehicle
        s, d = float(road.route_s[0]), float(road.route_d[0])
        error = av.heading - self.scenario.route.at(s)[2]
        hit = road.collision_partners()
        crash = bool(hit)
        if hit and not self.settings.end_on_collision:
            road.remove(hit)
        out = abs(d) > self.scenario.half_width
        wrong = bool(np.cos(error) < 0.0)
        arrived = s >= self.scenario.route.length - 8.0
        self._cost = float(len(hit))
        self._events = {
            "crash": crash,
            "out_of_road": out,
            "wrong_way": wrong,
            "success": arrived and not (out or wrong or crash),
        }

    def _count_stall(self) -> None:
        av, road = self.vehicle, self.road
        if av.speed > self.settings.stall_speed:
            self.stalled = 0
            return
        front, _ = road.neighbour_vehicles(av)
        moving = front is not None and front.speed > 0.5
        near = front is not None and np.hypot(*(front.position - av.position)) < 15.0
        waits_for_side = any(
            isinstance(v, TrafficVehicle) and v.spawn.side is not None and v.speed > 0.5
            for v in road.vehicles
        )
        self.stalled = 0 if (moving and near) or waits_for_side else self.stalled + 1

    def _observe(self) -> np.ndarray:
        return observe(self.road, self.vehicle, self.settings.observation)

    def _reward(self, action: Any) -> float:
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

    def _info(self, action: Any, obs: Any = None) -> dict[str, Any]:
        span = self.scenario.route.length - 8.0 - START
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
        road, av, route = self.road, self.vehicle, self.scenario.route
        wanted = command(action)
        hit, left, lateral, _ = look_ahead(
            av.position[0], av.position[1], av.heading, av.speed,
            wanted["acceleration"], wanted["steering"], self.settings.forecast_hold,
            -self.settings.forecast_braking, np.nan, STEERING, AutomatedVehicle.MAX_SPEED, 4.0,
            route.x, route.y, route.heading, self.scenario.half_width - self.settings.forecast_road_margin,
            road.others, road.predicted(), PREDICTION_STEP,
            self.settings.forecast_gap_margin, 0.4, 3.0,
        )  # fmt: skip
        return Forecast(
            bool(np.isfinite(hit)), bool(np.isfinite(left)), hit, left, lateral, self.stalled
        )

    def snapshot(self) -> Snapshot:
        """The scene now, for recordings."""
        road, platoon = self.road, self.road.platoon
        boxes = road.bodies[:, [0, 1, 2, 5, 6]] * np.array([1, 1, 1, 2, 2])
        first = 1 + road.followers
        traffic = first + sum(isinstance(v, TrafficVehicle) for v in road.vehicles)
        moving = np.array(
            [isinstance(v, TrafficVehicle) for v in road.vehicles[first:]], dtype=bool
        )
        rest = boxes[first:]
        is_traffic = np.concatenate([moving, np.zeros(len(rest) - len(moving), dtype=bool)])
        del traffic
        return Snapshot(
            time=self.time,
            vehicle=boxes[0],
            speed=self.vehicle.speed,
            acceleration=self.acceleration,
            followers=boxes[1:first],
            follower_speeds=platoon.speeds.copy(),
            follower_accelerations=platoon.accelerations.copy(),
            follower_gaps=platoon.gaps.copy(),
            traffic=rest[is_traffic],
            obstacles=rest[~is_traffic],
            distance=self.distance,
        )

    def road_polylines(self) -> list[RoadLine]:
        """Edges, markings, side roads and the route of the present scenario."""
        scenario = self.scenario
        lines = []
        for k in range(scenario.lanes + 1):
            path = scenario.route.shifted(k * LANE_WIDTH - scenario.half_width)
            edge = k in (0, scenario.lanes)
            lines.append(RoadLine(np.stack([path.x, path.y], 1), edge=edge))
        for side in scenario.sides:
            surface = side.path.part(*side.surface)
            for d in (-LANE_WIDTH / 2, LANE_WIDTH / 2):
                path = surface.shifted(d)
                lines.append(RoadLine(np.stack([path.x, path.y], 1), edge=False))
        route = scenario.route
        lines.append(RoadLine(np.stack([route.x, route.y], 1), edge=False, route=True))
        return lines

    def scenario_labels(self) -> ScenarioLabels:
        """Seed, block types and number of obstacles."""
        scenario = self.scenario
        kinds = tuple(kind for kind, _, _ in scenario.blocks)
        return ScenarioLabels(scenario.seed, kinds, len(scenario.obstacles))

    def settings_as_dict(self) -> dict[str, Any]:
        """The settings as plain nested mappings."""
        return asdict(self.settings)
