"""The N followers as bodies in MetaDrive's world.

The original code imagines followers only when it predicts a disturbance. Here they drive: each
rides the AV's trail by the paper's IDM, as in the default world, and stands in MetaDrive's world
as a vehicle that lasers see and that can be hit. MetaDrive's traffic looks for leaders by lane,
and a follower's lane there stays the one it started in. MetaDrive's own IDM drivers would not do:
they keep other gaps (10 m and 1.5 s) and lose the AV in a junction.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from metadrive.component.vehicle.vehicle_type import MVehicle
from metadrive.manager.base_manager import BaseManager
from panda3d.core import LVector3

from haim_torchrl.envs.geometry import COLUMNS
from haim_torchrl.envs.metadrive.config import MetaDriveConfig
from haim_torchrl.envs.metadrive.route import lane_middle
from haim_torchrl.envs.path import Array
from haim_torchrl.envs.platoon import Platoon

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
    # MetaDrive's lasers look 1.2 m above the road, over the roof of its default car.
    LENGTH, WIDTH = float(MVehicle.DEFAULT_LENGTH), float(MVehicle.DEFAULT_WIDTH)

    def __init__(self, settings: MetaDriveConfig) -> None:
        super().__init__()
        self._settings = settings
        self.platoon: Platoon | None = None
        self._vehicles: list[MVehicle] = []

    def before_reset(self) -> None:
        """Take them off the road."""
        for vehicle in self._vehicles:  # as MetaDrive made it, or it cannot take it off
            self._physics.removeRigidBody(vehicle.body)
            self._physics.attachVehicle(vehicle.system)
        super().before_reset()
        self.platoon, self._vehicles = None, []

    def after_reset(self) -> None:
        """Line them up behind the AV."""
        settings, av = self._settings, self.engine.agents["default_agent"]
        lane = av.lane
        start, _ = lane.local_coordinates(av.position)
        # A path has a sample every metre, and this one is to end where the AV stands.
        run_up = lane_middle(lane, start - math.floor(start) - 1e-6, start)
        self.platoon = Platoon(
            run_up,
            settings.followers,
            settings.follower_gap,
            settings.initial_speed,
            settings.idm,
            self.LENGTH,
            float(av.LENGTH),
        )
        for _ in range(settings.followers):
            config = {"spawn_lane_index": lane.index, "spawn_longitude": 0.0}
            vehicle = self.spawn_object(MVehicle, vehicle_config=config)
            vehicle.set_static(True)  # the platoon moves it, not the physics
            # Without its wheels, which would take a sixth of the physics' time for nothing.
            self._physics.removeVehicle(vehicle.system)
            self._vehicles.append(vehicle)
        self._place()
        for vehicle in self._vehicles:
            self._physics.attachRigidBody(vehicle.body)  # now, or lasers miss it until it moves

    @property
    def _physics(self) -> Any:
        return self.engine.physics_world.dynamic_world

    def after_step(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Follow the AV to its new position."""
        assert self.platoon is not None
        if self.engine.episode_step > 0:  # MetaDrive calls this once while it resets
            av = self.engine.agents["default_agent"]
            x, y = centre(av)
            self.platoon.step(np.array([x, -y]), float(av.speed), self._others(x, y), TIME_STEP)
            self._place()
        return {}

    def _place(self) -> None:
        assert self.platoon is not None
        poses = zip(
            self._vehicles, self.platoon.poses.tolist(), self.platoon.speeds.tolist(), strict=True
        )
        for vehicle, (x, y, heading), speed in poses:
            # In one call, and in the engine's words: degrees, zero to the left.
            origin, degrees = vehicle.origin, -90.0 - math.degrees(heading)
            origin.setPosHpr(x, -y, origin.getZ(), degrees, 0.0, 0.0)
            velocity = LVector3(speed * math.cos(heading), -speed * math.sin(heading), 0.0)
            vehicle.body.setLinearVelocity(velocity)

    def _others(self, x: float, y: float) -> Array:
        """Bodies of the traffic near the AV, [M, 10]."""
        rows = []
        for vehicle in self.engine.traffic_manager._traffic_vehicles:
            px, py = centre(vehicle)
            if abs(px - x) < RANGE and abs(py - y) < RANGE:
                rows.append(body(vehicle))
        return np.array(rows).reshape(-1, COLUMNS)


def centre(thing: Any) -> tuple[float, float]:
    """Centre of a vehicle or obstacle of MetaDrive, in its frame [m].

    As its ``position``, which takes ten times as long because it builds a vector.
    """
    place = thing.origin.getPos()
    return place[0], place[1]


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
    x, y = centre(thing)
    half_length, half_width = thing.LENGTH / 2, thing.WIDTH / 2
    speed = 0.0 if stands else float(thing.speed)
    return x, -y, -thing.heading_theta, speed, acceleration, half_length, half_width, path, 0.0, 0.0
