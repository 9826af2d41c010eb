"""The X+1+N world in CARLA, as a Gymnasium environment."""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.envs.carla.client import MakeClient, check_towns, connect
from haim_torchrl.envs.carla.config import CarlaConfig
from haim_torchrl.envs.carla.control import BRAKING
from haim_torchrl.envs.carla.drive import Drive
from haim_torchrl.envs.carla.frames import points_to_recording
from haim_torchrl.envs.carla.map.town import Town
from haim_torchrl.envs.carla.scenario import draw_scenario
from haim_torchrl.envs.carla.scene import Scene
from haim_torchrl.envs.carla.seat import Seat
from haim_torchrl.envs.forecast import forecast
from haim_torchrl.envs.semantic import SemanticObserver
from haim_torchrl.evaluation.recording import RoadLine, ScenarioLabels, Snapshot
from haim_torchrl.switches.protocol import Forecast


class CarlaSimulator(gym.Env):
    """One AV with N followers in a town with traffic, pedestrians and obstacles (X+1+N).

    It fulfils :class:`~haim_torchrl.envs.driving.DrivingSimulator`. Actions: (acceleration,
    steering) in [-1, 1]², see :mod:`~haim_torchrl.envs.carla.control`. Observation: an image and
    the speed, see :class:`~haim_torchrl.envs.semantic.SemanticObserver`. Reward and cost exist for
    evaluation and baselines only.

    The server's world is taken at the first reset, in synchronous mode; :meth:`close`, also at the
    end of a ``with`` or of the process, puts it back as it was. While another simulator of this
    process drives the same server (:class:`~haim_torchrl.envs.carla.seat.Seat`), a step here only
    says that the episode was cut off (``truncated``).

    Args:
        config: settings by name, see :class:`CarlaConfig`.
        make_client: makes the client of a host and a port; ``carla.Client`` by default.

    Raises:
        ValueError: settings that cannot work.
        RuntimeError: no server, one of another version, or one without the towns.
    """

    metadata = {"render_modes": []}

    def __init__(
        self, config: Mapping[str, Any] | None = None, make_client: MakeClient | None = None
    ) -> None:
        settings = self.settings = CarlaConfig.of(config)
        client = connect(settings.host, settings.ports[0], settings.timeout, make_client)
        check_towns(client, (settings.train_town, settings.test_town))
        self._observer = SemanticObserver(settings.observation)
        self.observation_space = self._observer.space
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._towns: dict[str, Town] = {}
        self._seat = Seat(settings, make_client)
        # Also at the end of the process: a world left in synchronous mode waits for ever.
        self._finalizer = weakref.finalize(self, self._seat.close)
        self._drive: Drive | None = None

    @property
    def followers(self) -> int:
        """Number N of followers."""
        return self.settings.followers

    @property
    def minimum_acceleration(self) -> float:
        """Strongest braking of the AV [m/s²], negative; nominal."""
        return -BRAKING

    @property
    def reflection(self) -> Reflection | None:
        """None: mirrored, a town would have its oncoming lane on the right."""
        return None

    @property
    def road(self) -> Scene:
        """The scene now, as the rule-based expert reads it."""
        return self._driven.road

    @property
    def _driven(self) -> Drive:
        if self._drive is None:
            raise RuntimeError("there is no episode yet; call reset() first")
        return self._drive

    # Episodes.
    def seed_draws(self, seed: int | None) -> None:
        """Seed the generator that scenarios of the set are drawn with; nothing moves."""
        super().reset(seed=seed)

    def reset(
        self, *, seed: int | None = None, options: dict | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start scenario `seed`, or one drawn from the configured set.

        Raises:
            ValueError: there is no such scenario.
            RuntimeError: other processes drive the servers, or something is in the way.
        """
        settings = self.settings
        town = None if seed is None else settings.town(seed)
        if seed is not None or self._np_random is None:
            super().reset(seed=seed)
        if seed is None:
            seed = settings.first_scenario + int(self.np_random.integers(settings.scenarios))
        town = town or settings.town(seed)
        session = self._seat.take()
        session.begin(town, int(seed))
        if town not in self._towns:
            self._towns[town] = Town(session.world.get_map())
        scenario = draw_scenario(self._towns[town], int(seed), settings)
        self._observer.reset(self._towns[town].layers(scenario.route))
        self._drive = Drive(session, settings, self._towns[town], scenario)
        return self._observe(), self._drive.info()

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Drive one step of 0.1 s.

        Raises:
            RuntimeError: before the first reset, or if the server no longer answers.
        """
        drive = self._driven
        if drive.session.closed:
            drive.cut_off()
            return self._observe(), 0.0, False, True, drive.info()
        reward = drive.advance(action)
        events = drive.events
        terminated = events.out_of_road or events.wrong_way or events.success
        terminated = terminated or (events.crash and self.settings.end_on_collision)
        truncated = drive.steps >= self.settings.horizon and not terminated
        return self._observe(), float(reward), terminated, truncated, drive.info()

    def close(self) -> None:
        """Put the server's world back as it was; a second call changes nothing."""
        self._seat.close()
        super().close()

    def _observe(self) -> dict[str, Any]:
        return dict(self._observer.observe(self.snapshot()))

    # What switches, mentors and recorders ask.
    def forecast(self, action: np.ndarray) -> Forecast:
        """Where the action leads if it is held for a moment and the AV then brakes."""
        settings, drive = self.settings, self._driven
        pedal, wheel = np.clip(np.asarray(action, dtype=float), -1.0, 1.0).tolist()
        acceleration, steering = drive.model.command(pedal, wheel)
        return forecast(
            drive.road,
            acceleration,
            steering,
            hold=settings.forecast_hold,
            braking=settings.forecast_braking,
            road_margin=settings.forecast_road_margin,
            gap_margin=settings.forecast_gap_margin,
            stalled_steps=drive.stalled_steps,
        )

    def snapshot(self) -> Snapshot:
        """The scene now."""
        return self._driven.snapshot()

    def road_polylines(self) -> list[RoadLine]:
        """Edges and markings of the town, and the route."""
        scenario = self._driven.scenario
        path = scenario.route.path
        points = points_to_recording(np.stack([path.x, path.y], axis=1))
        lines = self._towns[scenario.town].lines
        return [*lines, RoadLine(points, edge=False, route=True)]

    def scenario_labels(self) -> ScenarioLabels:
        """Seed, what the route leads through, and number of obstacles."""
        scenario = self._driven.scenario
        return ScenarioLabels(scenario.seed, scenario.route.blocks, len(scenario.obstacles))
