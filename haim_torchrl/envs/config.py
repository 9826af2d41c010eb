"""Settings of the X+1+N world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from haim_torchrl.envs.observation import ObservationConfig
from haim_torchrl.envs.scenario import ScenarioConfig
from haim_torchrl.envs.semantic import SemanticConfig
from haim_torchrl.envs.vehicles import AutomatedVehicle
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
        end_on_collision: whether a collision ends the episode. Otherwise the vehicle or obstacle
            hit is removed, as if towed away, and the AV goes on.
        forecast_hold: how long the risk forecast holds the agent's action [s].
        forecast_braking: how hard it brakes afterwards [m/s²].
        forecast_road_margin: how far inside the road's edge the AV's centre has to stay in the
            forecast [m]; 1 m is half of the vehicle's width.
        forecast_gap_margin: distance to others that the forecast asks for, ahead and behind [m].
        stall_speed: driving slower than this share of the road's comfortable speed without cause
            counts as stalling. A policy that only has to avoid takeovers learns to crawl just
            above the speed that a mentor tolerates, and does not arrive in time.
        scenario: what scenarios are drawn from.
        observation: what the agent sees: numbers, or an image and its speed.
        idm: the followers' car-following parameters.
    """

    first_scenario: int = 0
    scenarios: int = 50
    followers: int = 5
    follower_gap: float = 15.0
    initial_speed: float = 0.0
    horizon: int = 1000
    end_on_collision: bool = True
    forecast_hold: float = 1.0
    forecast_braking: float = 5.0
    forecast_road_margin: float = 0.8
    forecast_gap_margin: float = 1.5
    stall_speed: float = 0.6
    scenario: ScenarioConfig = field(default_factory=ScenarioConfig)
    observation: ObservationConfig | SemanticConfig = field(default_factory=ObservationConfig)
    idm: IDMParameters = field(default_factory=IDMParameters)

    def __post_init__(self) -> None:
        if self.first_scenario < 0:
            raise ValueError(f"first_scenario: must not be negative, got {self.first_scenario}")
        if self.scenarios < 1:
            raise ValueError(f"scenarios: must be at least 1, got {self.scenarios}")
        if not 1 <= self.followers <= 5:
            raise ValueError(f"followers: must be between 1 and 5, got {self.followers}")
        if self.horizon < 1:
            raise ValueError(f"horizon: must be at least 1, got {self.horizon}")
        if not 0 <= self.initial_speed <= AutomatedVehicle.MAX_SPEED:
            raise ValueError(f"initial_speed: must be in [0, 15] m/s, got {self.initial_speed}")
        if self.forecast_braking <= 0:
            raise ValueError(f"forecast_braking: must be positive, got {self.forecast_braking}")
        for name in ("follower_gap", "forecast_hold", "forecast_gap_margin", "stall_speed"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}: must not be negative, got {getattr(self, name)}")

    @classmethod
    def of(cls, settings: Mapping[str, Any] | None) -> PlatoonConfig:
        """Settings from a mapping; parts (scenario, observation, idm) may be mappings, too.

        Raises:
            ValueError: an unknown key.
        """
        parts = {"scenario": ScenarioConfig, "observation": ObservationConfig, "idm": IDMParameters}
        return cls(**read_settings(settings, cls, parts))


def read_settings(
    settings: Mapping[str, Any] | None, kind: Any, parts: Mapping[str, Any]
) -> dict[str, Any]:
    """Arguments of a world's settings from a mapping; an image's settings are told by their view.

    Args:
        settings: names and values.
        kind: dataclass of the settings.
        parts: dataclasses of the parts, which may be mappings, too.

    Raises:
        ValueError: an unknown key.
    """
    values = dict(settings or {})
    _check_names(values, kind, "env")
    if isinstance(values.get("observation"), Mapping):
        values["observation"] = SemanticConfig.of(values["observation"]) or values["observation"]
    for name, part in parts.items():
        if isinstance(values.get(name), Mapping):
            given = {
                key: tuple(value) if isinstance(value, list) else value
                for key, value in values[name].items()
            }
            _check_names(given, part, f"env.{name}")
            values[name] = part(**given)
    return values


def _check_names(values: Mapping[str, Any], kind: Any, where: str) -> None:
    known = {f.name for f in fields(kind)}
    unknown = sorted(set(values) - known)
    if unknown:
        raise ValueError(f"{where}: unknown setting {unknown[0]!r}; choose from {sorted(known)}")
