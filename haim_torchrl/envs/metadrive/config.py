"""Settings of the MetaDrive world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from haim_torchrl.envs.config import read_settings
from haim_torchrl.envs.observation import ObservationConfig
from haim_torchrl.envs.semantic import SemanticConfig
from haim_torchrl.traffic.car_following import IDMParameters


@dataclass(frozen=True)
class MetaDriveObservation(ObservationConfig):
    """What the agent sees, in numbers.

    In the view ``route`` it is that of the default world
    (:func:`~haim_torchrl.envs.observation.observe`). In the view ``rays`` it is MetaDrive's own
    vector of 259 numbers, the paper's observation: 9 of the car's state (two of them its last
    action), 10 of navigation, and `rays` laser ranges; `closeness`, `relative_speed`,
    `navigation` and `strips` mean nothing to it.

    Attributes:
        motion: whether MetaDrive's vector tells steering, last action and yaw rate, as in the
            paper. Without, these four numbers are constant: a learner that sees its last action
            copies it (docs/results.md).
    """

    motion: bool = True


@dataclass(frozen=True)
class MetaDriveConfig:
    """Settings of the world; the defaults are the paper's.

    Attributes:
        first_scenario, scenarios: the set of seeds that resets draw from.
        blocks: road blocks behind the first straight.
        lanes: lanes of each road.
        lane_width: their width [m].
        traffic_density: share of the places, 10 m apart on each lane, that hold a vehicle.
        accident_probability: probability that a straight, curve or ramp holds an accident or a
            construction site.
        speed_limit: of the AV [m/s]: 40 km/h.
        max_steering: front-wheel angle at full steering [rad]. MetaDrive's car turns its wheels by
            0.70, which at 30 km/h throws it off the road; 0.35 does for each of its bends.
        max_braking: deceleration at full braking [m/s²]. MetaDrive's car locks its wheels.
        followers: N.
        follower_gap: their initial bumper-to-bumper gaps [m].
        initial_speed: of the AV and its followers [m/s].
        horizon: steps until an episode is cut off.
        end_on_collision: whether a collision ends the episode.
        contact_pause: seconds without contact after which a contact is a new collision.
        cached_maps: whether road maps stay in memory after their episode; a map takes some
            0.2 s to build.
        render: ``none``, or ``3d`` for MetaDrive's own window, which needs its assets.
        forecast_hold, forecast_braking, forecast_road_margin, forecast_gap_margin, stall_speed:
            as in :class:`~haim_torchrl.envs.PlatoonConfig`.
        observation: what the agent sees: numbers or an image.
        idm: the followers' car-following parameters.
    """

    first_scenario: int = 0
    scenarios: int = 50
    blocks: int = 3
    lanes: int = 3
    lane_width: float = 3.5
    traffic_density: float = 0.2
    accident_probability: float = 0.8
    speed_limit: float = 11.1
    max_steering: float = 0.35
    max_braking: float = 8.0
    followers: int = 5
    follower_gap: float = 15.0
    initial_speed: float = 0.0
    horizon: int = 1000
    end_on_collision: bool = False
    contact_pause: float = 1.0
    cached_maps: bool = True
    render: str = "none"
    forecast_hold: float = 1.0
    forecast_braking: float = 5.0
    forecast_road_margin: float = 0.8
    forecast_gap_margin: float = 1.5
    stall_speed: float = 0.6
    observation: MetaDriveObservation | SemanticConfig = field(default_factory=MetaDriveObservation)
    idm: IDMParameters = field(default_factory=IDMParameters)

    def __post_init__(self) -> None:
        for name, low in (("first_scenario", 0), ("scenarios", 1), ("blocks", 1), ("lanes", 2),
                          ("followers", 1), ("horizon", 1)):  # fmt: skip
            if getattr(self, name) < low:
                raise ValueError(f"{name}: must be at least {low}, got {getattr(self, name)}")
        if self.followers > 5:
            raise ValueError(f"followers: must be between 1 and 5, got {self.followers}")
        for name in ("traffic_density", "accident_probability"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}: must be in [0, 1], got {getattr(self, name)}")
        for name in (
            "speed_limit",
            "lane_width",
            "forecast_braking",
            "follower_gap",
            "max_steering",
            "max_braking",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: must be positive, got {getattr(self, name)}")
        for name in ("initial_speed", "contact_pause", "forecast_hold", "forecast_gap_margin"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}: must not be negative, got {getattr(self, name)}")
        if self.render not in ("none", "3d"):
            raise ValueError(f"render: choose 'none' or '3d', got {self.render!r}")

    @classmethod
    def of(cls, settings: Mapping[str, Any] | None) -> MetaDriveConfig:
        """Settings from a mapping; parts (observation, idm) may be mappings, too.

        Raises:
            ValueError: an unknown key.
        """
        parts = {"observation": MetaDriveObservation, "idm": IDMParameters}
        return cls(**read_settings(settings, cls, parts))
