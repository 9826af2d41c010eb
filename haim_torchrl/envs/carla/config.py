"""Settings of the CARLA world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from haim_torchrl.envs.semantic import SemanticConfig
from haim_torchrl.traffic.car_following import IDMParameters

LAST_SEED = 2**32 - 1
"""The largest scenario number."""


@dataclass(frozen=True)
class CarlaConfig:
    """Settings of the world.

    Attributes:
        first_scenario, scenarios: the set of seeds that resets without a seed draw from.
        host: machine that the servers run on.
        ports: their ports. One server serves one simulator at a time.
        timeout: how long an answer of a server may take [s].
        rendering: whether the server draws its own pictures; nothing here needs them.
        train_town, test_town: where the scenarios below `test_from`, and from it on, are driven.
        test_from: first scenario in `test_town`.
        followers: N.
        follower_gap: their initial bumper-to-bumper gaps [m].
        horizon: steps until an episode is cut off.
        end_on_collision: whether a collision ends the episode. Otherwise the traffic, pedestrian or
            obstacle hit is removed, and the AV goes on.
        vehicle: blueprint of the AV and its followers.
        route_length: least and greatest length of the way to drive [m].
        off_route: farther from the route's middle than this is out of the road, although it may
            be a lane [m].
        traffic, pedestrians: how many to place in the town.
        obstacles: probabilities of 0, 1, 2, ... obstacles on a route.
        obstacle_offset: how far right of the lane's middle they stand [m].
        forecast_hold: how long the risk forecast holds the agent's action [s].
        forecast_braking: how hard it brakes afterwards [m/s²].
        forecast_road_margin: how far inside its lane the AV's centre has to stay in it [m].
        forecast_gap_margin: distance to others that it asks for, ahead and behind [m].
        stall_speed: driving slower than this share of the road's comfortable speed without cause
            counts as stalling.
        observation: what the semantic image shows.
        idm: the followers' car-following parameters.
    """

    first_scenario: int = 0
    scenarios: int = 50
    host: str = "127.0.0.1"
    ports: tuple[int, ...] = (2000,)
    timeout: float = 20.0
    rendering: bool = False
    train_town: str = "Town01"
    test_town: str = "Town02"
    test_from: int = 20_000
    followers: int = 5
    follower_gap: float = 15.0
    horizon: int = 1000
    end_on_collision: bool = True
    vehicle: str = "vehicle.tesla.model3"
    route_length: tuple[float, float] = (150.0, 400.0)
    off_route: float = 5.0
    traffic: int = 30
    pedestrians: int = 20
    obstacles: tuple[float, ...] = (0.5, 0.5)
    obstacle_offset: float = 1.8
    forecast_hold: float = 1.0
    forecast_braking: float = 5.0
    forecast_road_margin: float = 0.8
    forecast_gap_margin: float = 1.5
    stall_speed: float = 0.6
    observation: SemanticConfig = field(default_factory=SemanticConfig)
    idm: IDMParameters = field(default_factory=IDMParameters)

    def __post_init__(self) -> None:
        self._check_scenarios()
        self._check_server()
        if not 1 <= self.followers <= 5:
            raise ValueError(f"followers: must be between 1 and 5, got {self.followers}")
        if self.horizon < 1:
            raise ValueError(f"horizon: must be at least 1, got {self.horizon}")
        low, high = self.route_length
        if not 50.0 <= low <= high:
            raise ValueError(
                f"route_length: must be two lengths of at least 50 m, the least first, got {low} "
                f"and {high}"
            )
        if not self.obstacles or min(self.obstacles) < 0 or sum(self.obstacles) <= 0:
            raise ValueError(
                "obstacles: must be probabilities of 0, 1, 2, ... obstacles, got "
                f"{list(self.obstacles)}"
            )
        for name in ("off_route", "forecast_braking"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: must be positive, got {getattr(self, name)}")
        if self.follower_gap < 2.0:
            raise ValueError(f"follower_gap: must be at least 2 m, got {self.follower_gap}")
        for name in (
            *("traffic", "pedestrians", "obstacle_offset"),
            *("forecast_hold", "forecast_road_margin", "forecast_gap_margin", "stall_speed"),
        ):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}: must not be negative, got {getattr(self, name)}")

    def _check_scenarios(self) -> None:
        if self.scenarios < 1:
            raise ValueError(f"scenarios: must be at least 1, got {self.scenarios}")
        first, last = self.first_scenario, self.first_scenario + self.scenarios - 1
        if not 0 <= first <= last <= LAST_SEED:
            raise ValueError(
                f"first_scenario: the scenarios {first} to {last} must lie between 0 and "
                f"{LAST_SEED}"
            )
        if self.town(first) != self.town(last):
            raise ValueError(
                f"test_from: the scenarios {first} to {last} lie on both sides of "
                f"{self.test_from}, so that they mix {self.train_town} and {self.test_town}; "
                "change the set's start or count, or env.test_from"
            )

    def _check_server(self) -> None:
        if not self.ports or not all(0 < port < 2**16 - 6000 for port in self.ports):
            raise ValueError(
                "ports: must be one or more numbers between 1 and 59535, as the traffic manager "
                f"takes the port 6000 higher; got {list(self.ports)}"
            )
        if not self.timeout > 0:
            raise ValueError(f"timeout: must be positive [s], got {self.timeout}")

    def town(self, scenario: int) -> str:
        """The town that a scenario is driven in.

        Raises:
            ValueError: no such scenario.
        """
        if not 0 <= scenario <= LAST_SEED:
            raise ValueError(
                f"scenario {scenario} does not exist: {self.train_town} has 0 to "
                f"{self.test_from - 1} and {self.test_town} {self.test_from} to {LAST_SEED}"
            )
        return self.train_town if scenario < self.test_from else self.test_town

    @classmethod
    def of(cls, settings: Mapping[str, Any] | None) -> CarlaConfig:
        """Settings from a mapping; parts (observation, idm) may be mappings, too.

        Raises:
            ValueError: an unknown key, or a value that cannot work.
        """
        values = _known(settings or {}, cls, "env")
        if isinstance(seen := values.get("observation"), Mapping):
            values["observation"] = SemanticConfig.of(seen)
            if values["observation"] is None:
                raise ValueError("observation: CARLA has images only; use env/observation=semantic")
        if isinstance(values.get("idm"), Mapping):
            values["idm"] = IDMParameters(**_known(values["idm"], IDMParameters, "env.idm"))
        return cls(**values)


def _known(values: Mapping[str, Any], kind: Any, where: str) -> dict[str, Any]:
    """The values with lists made tuples, if the dataclass has a field for each."""
    names = sorted(f.name for f in fields(kind))
    unknown = sorted(set(values) - set(names))
    if unknown:
        raise ValueError(f"{where}: unknown setting {unknown[0]!r}; choose from {names}")
    return {
        key: tuple(value) if isinstance(value, list) else value for key, value in values.items()
    }
