"""The N followers as bodies in MetaDrive's world.

The original code imagines followers only when it predicts a disturbance. Here they drive: each
rides the AV's trail by the paper's IDM, as in the default world, and stands in MetaDrive's world as
a vehicle that lasers see, traffic gives way to, and that can be hit. MetaDrive's own IDM
drivers would not do: they keep other gaps (10 m and 1.5 s) and lose the AV in a junction.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from metadrive.component.vehicle.vehicle_type import DefaultVehicle
from metadrive.manager.base_manager import BaseManager

from haim_torchrl.envs.geometry import COLUMNS
from haim_torchrl.envs.metadrive.config import MetaDriveConfig
from haim_torchrl.envs.metadrive.route import lane_middle
from haim_torchrl.envs.path import Array
from haim_torchrl.envs.platoon import Platoon
from haim_torchrl.traffic.car_following import IDMParameters

TIME_STEP = 0.1
"""Duration of a step [s]."""
RANGE = 150.0
"""Vehicles farther from the AV than this [m] stand on no follower's way."""


class FollowerManager(BaseManager):
    """Puts the followers on the road and moves them after each step of the physics.

    Args:
        settings: settings of the world.

    Attributes:
        platoon: their states; made anew in each episode.
    """

    PRIORITY = 20  # after the AV and the traffic
    LENGTH = float(DefaultVehicle.DEFAULT_LENGTH)

    def __init__(self, settings: MetaDriveConfig) -> None:
        super().__init__()
        self._settings = settings
        self._idm: IDMParameters = settings.idm
        self.platoon: Platoon | None = None
        self._vehicles: list[DefaultVehicle] = []

    def before_reset(self) -> None:
        """Take them off the road."""
        super().before_reset()
        self.platoon, self._vehicles = None, []

    def after_reset(self) -> None:
        """Line them up behind the AV."""
        settings, av = self._settings, self.engine.agents["default_agent"]
        lane = av.lane
        start, _ = lane.local_coordinates(av.position)
        run_up = lane_middle(lane, 0.0, start)
        self.platoon = Platoon(
            run_up,
            settings.followers,
            settings.follower_gap,
            settings.initial_speed,
            self._idm,
            self.LENGTH,  # of the AV, too
        )
        for _ in range(settings.followers):
            config = {"spawn_lane_index": lane.index, "spawn_longitude": 0.0}
            vehicle = self.spawn_object(DefaultVehicle, vehicle_config=config)
            vehicle.set_static(True)  # the platoon moves it, not the physics
            self._vehicles.append(vehicle)
        self._place(lane)

    def after_step(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Follow the AV to its new position."""
        assert self.platoon is not None
        if self.engine.episode_step > 0:  # MetaDrive calls this once while it resets
            av = self.engine.agents["default_agent"]
            x, y = av.position
            self.platoon.step(np.array([x, -y]), float(av.speed), self._others(x, y), TIME_STEP)
            self._place(av.lane)
        return {}

    def _place(self, lane: Any) -> None:
        assert self.platoon is not None
        poses = zip(self._vehicles, self.platoon.poses, self.platoon.speeds, strict=True)
        for vehicle, (x, y, heading), speed in poses:
            vehicle.set_position((x, -y))
            vehicle.set_heading_theta(-heading)
            vehicle.set_velocity((np.cos(heading), -np.sin(heading)), float(speed))

    def _others(self, x: float, y: float) -> Array:
        """Bodies of the traffic near the AV, [M, 10]."""
        rows = []
        for vehicle in self.engine.traffic_manager._traffic_vehicles:
            px, py = vehicle.position
            if abs(px - x) < RANGE and abs(py - y) < RANGE:
                rows.append(body(vehicle))
        return np.array(rows).reshape(-1, COLUMNS)


def body(
    thing: Any, acceleration: float = 0.0, path: int = -1, *, stands: bool = False
) -> tuple[float, ...]:
    """The row of a vehicle or obstacle of MetaDrive; see :mod:`haim_torchrl.envs.geometry`.

    Args:
        thing: the vehicle or obstacle.
        acceleration: its acceleration [m/s²].
        path: index of the path that it drives; -1: none.
        stands: that it cannot move; MetaDrive reports speeds of 12 m/s for some barriers.
    """
    x, y = thing.position
    half_length, half_width = thing.LENGTH / 2, thing.WIDTH / 2
    speed = 0.0 if stands else float(thing.speed)
    return x, -y, -thing.heading_theta, speed, acceleration, half_length, half_width, path, 0.0, 0.0
