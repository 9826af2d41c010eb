"""The MetaDrive world as a Gymnasium environment with the default world's keys and meaning."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.envs.forecast import StallCounter, forecast
from haim_torchrl.envs.metadrive.car import GRIP, car_model, to_metadrive
from haim_torchrl.envs.metadrive.config import MetaDriveConfig
from haim_torchrl.envs.metadrive.engine import open_engine
from haim_torchrl.envs.metadrive.road import MetaDriveRoad
from haim_torchrl.envs.metadrive.scene import lane_layers, lane_lines, take_snapshot
from haim_torchrl.envs.metadrive.view import make_view
from haim_torchrl.envs.semantic import RoadLayers
from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.switches.protocol import Forecast

TIME_STEP = 0.1
"""Duration of a step [s]."""


class MetaDriveSimulator(gym.Env):
    """One AV with N followers on MetaDrive's random roads; a ``DrivingSimulator``.

    Actions: (acceleration, steering) in [-1, 1]², steering positive to the right: full throttle
    gives 2.8 m/s², full braking and full steering what the settings say. Reward, arrival and
    leaving the route are MetaDrive's; a collision is counted once, not in each step of contact
    (decision 16).

    Args:
        settings: settings of the world.

    Raises:
        RuntimeError: this process has an engine already, or assets are missing.
    """

    metadata = {"render_modes": []}

    def __init__(self, settings: MetaDriveConfig) -> None:
        self.settings = settings
        self._env = open_engine(settings)
        self._closed = False
        self._view = make_view(settings.observation, self._env.observation_space.shape[0])
        self.observation_space = self._view.space
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.road: MetaDriveRoad

    @property
    def followers(self) -> int:
        """Number N of followers."""
        return self.settings.followers

    @property
    def minimum_acceleration(self) -> float:
        """Strongest braking for which the wheels hold on to the road [m/s²]."""
        return -min(self.settings.max_braking, GRIP)

    @property
    def reflection(self) -> Reflection | None:
        """What a mirror does to observations and actions; None for MetaDrive's own vector."""
        return self._view.reflection

    @property
    def agent(self) -> Any:
        """MetaDrive's vehicle of the AV."""
        return self._env.agent

    # Episodes.
    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start scenario `seed`, or one drawn from the configured set.

        Raises:
            ValueError: the scenario is outside the configured set.
            RuntimeError: the engine has been closed.
        """
        if self._closed:
            raise RuntimeError("this MetaDrive environment is closed; make a new one")
        if seed is not None or self._np_random is None:
            super().reset(seed=seed)
        settings = self.settings
        first, count = settings.first_scenario, settings.scenarios
        if seed is None:
            seed = first + int(self.np_random.integers(count))
        if not first <= seed < first + count:
            raise ValueError(
                f"scenario {seed} is outside this environment's {first} to {first + count - 1}, "
                "which MetaDrive fixes when its engine starts; set env.first_scenario and "
                "env.scenarios, or eval.<set>.start and .count"
            )
        env = self._env
        observation, _ = env.reset(seed=int(seed))
        env.agent.config["max_speed_km_h"] = 3.6 * settings.speed_limit
        if settings.initial_speed:
            env.agent.set_velocity(env.agent.heading, settings.initial_speed)
        platoon = env.engine.follower_manager.platoon
        self.road = MetaDriveRoad(
            env, platoon, settings.lanes, settings.lane_width, car_model(env.agent, settings)
        )
        self._start = self.road.av_on_route[0]
        self.steps, self.distance, self.acceleration = 0, 0.0, 0.0
        self._stall = StallCounter(settings.initial_speed)
        self._slow, self._stalls_at = 0.0, 0
        self._last_contact = {"vehicle": -math.inf, "object": -math.inf}
        self._events = dict.fromkeys(("crash", "out_of_road", "wrong_way", "success"), False)
        self._cost = 0.0
        self._view.reset(self)
        return self._view.observe(self, observation), self._info()

    def seed_draws(self, seed: int | None) -> None:
        """Seed the generator that draws scenarios of the set."""
        super().reset(seed=seed)

    def step(self, action: np.ndarray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Drive one step of 0.1 s.

        Raises:
            ValueError: the action is not two finite numbers.
        """
        command = to_metadrive(self.agent, *self._command(action))
        av = self.road.av
        speed, position = av.speed, av.position
        observation, reward, terminated, truncated, info = self._env.step(command)
        self.road.refresh()
        self.steps += 1
        self.distance += math.dist(av.position, position)
        touching = self._judge(info)
        # A crash stops the car, but says nothing about how it was braked.
        self.acceleration = 0.0 if touching else (av.speed - speed) / TIME_STEP
        self._count_stall()
        truncated = bool(truncated) and not terminated
        seen = self._view.observe(self, observation)
        return seen, float(reward), bool(terminated), truncated, self._info()

    def close(self) -> None:
        """Stop the engine, so that this process may start another one."""
        if not self._closed:  # a second time the engine may be another simulator's
            self._closed = True
            self._env.close()

    def _command(self, action: np.ndarray) -> tuple[float, float]:
        """Acceleration [m/s²] and front-wheel angle [rad]."""
        pedal, wheel = map(float, action)
        if not (math.isfinite(pedal) and math.isfinite(wheel)):
            raise ValueError(f"action: must be two finite numbers, got {[pedal, wheel]}")
        pedal, wheel = min(max(pedal, -1.0), 1.0), min(max(wheel, -1.0), 1.0)
        return self.road.av.model.command(pedal, wheel)

    def _judge(self, info: dict[str, Any]) -> bool:
        """Note what happened in the step; returns whether the AV touches anything."""
        now = self.steps * TIME_STEP
        contacts = {
            "vehicle": info["crash_vehicle"] or info["crash_human"],
            "object": info["crash_object"] or info["crash_building"],
        }
        hits = 0
        for kind, touching in contacts.items():
            if touching:
                hits += now - self._last_contact[kind] > self.settings.contact_pause + 1e-6
                self._last_contact[kind] = now
        route = self.scenario_route_heading()
        self._cost = float(hits)
        self._events = {
            "crash": hits > 0,
            "out_of_road": bool(info["out_of_road"]),
            "wrong_way": math.cos(self.road.av.heading - route) < 0.0,
            "success": bool(info["arrive_dest"]),
        }
        return any(contacts.values())

    def scenario_route_heading(self) -> float:
        """Heading of the route beside the AV [rad]."""
        s, _ = self.road.av_on_route
        return self.road.scenario.route.at(s)[2]

    def _count_stall(self) -> None:
        road, av = self.road, self.road.av
        s, d = road.av_on_route
        wanted = min(self.settings.speed_limit, road.lanes[road.scenario.lane_at(d)].speed_at(s))
        slow = self.settings.stall_speed * wanted
        self._slow = slow
        if av.speed > slow:
            self._stall.update(av.speed, slow, held_up=False)

    def _info(self) -> dict[str, Any]:
        road = self.road
        span = road.scenario.route.length - 5.0 - self._start
        return {
            "speed": road.av.speed,
            "acceleration": self.acceleration,
            "follower_gaps": road.platoon.gaps.astype(np.float32),
            "follower_speeds": road.platoon.speeds.astype(np.float32),
            "progress": min(max((road.av_on_route[0] - self._start) / span, 0.0), 1.0),
            "cost": self._cost,
            **self._events,
        }

    # What switches, mentors and recorders ask.
    def forecast(self, action: np.ndarray) -> Forecast:
        """Where the action leads if it is held for a moment and the AV then brakes.

        Slow steps count as stalled if somebody asks here in each of them.
        """
        settings, speed = self.settings, self.road.av.speed
        if speed <= self._slow and self._stalls_at < self.steps:
            self._stall.update(speed, self._slow, self.road.held_up(self._slow))
            self._stalls_at = self.steps
        acceleration, angle = self._command(action)
        return forecast(
            self.road,
            max(acceleration, -GRIP),
            angle,
            hold=settings.forecast_hold,
            braking=settings.forecast_braking,
            road_margin=settings.forecast_road_margin,
            gap_margin=settings.forecast_gap_margin,
            stalled_steps=self._stall.steps,
        )

    def snapshot(self) -> Snapshot:
        """The scene now, for recordings."""
        return take_snapshot(self.road, self.steps * TIME_STEP, self.acceleration, self.distance)

    def road_polylines(self) -> list[RoadLine]:
        """Lines of all roads, and the route."""
        return lane_lines(self._env.current_map.road_network.graph, self.road.scenario)

    def road_layers(self) -> RoadLayers:
        """Surfaces, lines and the route's carriageway of the present scenario, for images."""
        return lane_layers(self._env.current_map.road_network.graph, self.road.scenario)

    def scenario_labels(self) -> ScenarioLabels:
        """Seed, block types and number of obstacles."""
        engine = self._env.engine
        obstacles = getattr(engine, "object_manager", None)
        return ScenarioLabels(
            int(self._env.current_seed),
            tuple(KINDS.get(block.ID, block.ID) for block in self._env.current_map.blocks[1:]),
            0 if obstacles is None else len(obstacles.spawned_objects),
        )


KINDS = {
    "S": "straight",
    "C": "curve",
    "r": "ramp",
    "R": "ramp",
    "X": "intersection",
    "T": "t_junction",
    "O": "roundabout",
    "f": "fork",
    "F": "fork",
}
"""MetaDrive's letters for the blocks, by the default world's names."""
