"""The actors of an episode: placed, moved and read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from haim_torchrl.envs.carla.collisions import CollisionSensor, Other
from haim_torchrl.envs.carla.config import CarlaConfig
from haim_torchrl.envs.carla.frames import Pose, centre_of, origin_of, transform_of
from haim_torchrl.envs.carla.package import carla_package
from haim_torchrl.envs.carla.scenario import CarlaScenario
from haim_torchrl.envs.carla.scene import Body
from haim_torchrl.envs.carla.session import TIME_STEP, Session

DROP = 0.5
"""Vehicles are placed this high above the road [m], and fall: lower down CARLA sees a collision."""
SETTLING = 10
"""Steps until everything has come to rest on the road."""
WALKING = 1.4
"""Speed of pedestrians [m/s]."""


class Cast:
    """The actors of one episode.

    Args:
        session: the world.
        config: settings.
        scenario: where everything starts.
        followers: poses of the followers.
        height: height of the road at a point [m].

    Attributes:
        av: the automated vehicle's actor.
        follower_sizes: length and width of each follower [m].
        collisions: the AV's collision sensor.
        full_lock: the AV's front-wheel angle at steer = 1 [rad].

    Raises:
        RuntimeError: something is in the AV's or a follower's way.
    """

    def __init__(
        self,
        session: Session,
        config: CarlaConfig,
        scenario: CarlaScenario,
        followers: Iterable[Pose],
        height: Callable[[float, float], float],
    ) -> None:
        self._session, self._height = session, height
        self._rng = np.random.default_rng([scenario.seed, 1])
        self._library = session.world.get_blueprint_library()
        self._speeds: dict[int, float] = {}
        self.av = self._place(config.vehicle, scenario.route.path.at(scenario.start), "hero")
        self.followers = [self._place(config.vehicle, pose, "follower") for pose in followers]
        for actor in self.followers:
            actor.set_simulate_physics(False)
        self.follower_sizes = [_size(actor.bounding_box) for actor in self.followers]
        self.props = [self._prop(name, pose) for name, pose in scenario.obstacles]
        self.traffic = self._traffic(config.traffic, scenario.places)
        self.walkers = self._walkers(config.pedestrians)
        self.collisions = CollisionSensor(session, self.av)
        wheels = self.av.get_physics_control().wheels
        self.full_lock = math.radians(max(wheel.max_steer_angle for wheel in wheels))
        self._settle()

    # Placing.
    def _place(self, name: str, pose: Pose, role: str) -> Any:
        blueprint = self._library.find(name)
        blueprint.set_attribute("role_name", role)
        actor = self._session.spawn(blueprint, self._above(pose))
        if actor is None:
            raise RuntimeError(
                f"CARLA could not place the {role} at ({pose[0]:.1f}, {pose[1]:.1f}); something "
                "is in the way: reload the town, or leave this scenario out"
            )
        return actor

    def _above(self, pose: Pose) -> Any:
        return transform_of(pose, self._height(pose[0], pose[1]) + DROP)

    def _prop(self, name: str, pose: Pose) -> Any:
        """An obstacle, which stands on the road; None where something else does."""
        transform = transform_of(pose, self._height(pose[0], pose[1]))
        return self._session.spawn(self._library.find(name), transform)

    def _traffic(self, count: int, places: Iterable[Pose]) -> list[Any]:
        manager, port = self._session.traffic_manager, self._session.traffic_port
        cars = [b for b in self._library.filter("vehicle.*") if _is_car(b)]
        cars.sort(key=lambda blueprint: blueprint.id)
        placed: list[Any] = []
        for pose in places:
            if len(placed) == count:
                break
            blueprint = cars[int(self._rng.integers(len(cars)))]
            actor = self._session.spawn(blueprint, self._above(pose))
            if actor is not None:
                actor.set_autopilot(True, port)
                # The image shows no lights: nobody minds them.
                manager.ignore_lights_percentage(actor, 100.0)
                placed.append(actor)
        return placed

    def _walkers(self, count: int) -> list[Any]:
        world = self._session.world
        blueprints = sorted(self._library.filter("walker.pedestrian.*"), key=lambda b: b.id)
        placed = []
        for _ in range(count):
            place = world.get_random_location_from_navigation()
            blueprint = blueprints[int(self._rng.integers(len(blueprints)))]
            if blueprint.has_attribute("is_invincible"):
                blueprint.set_attribute("is_invincible", "false")
            if place is None:
                continue
            walker = self._session.spawn(blueprint, carla_package().Transform(place))
            if walker is not None:
                placed.append(walker)
        return placed

    def _settle(self) -> None:
        """Let everything fall onto the road; the AV brakes, pedestrians set out."""
        self.av.apply_control(carla_package().VehicleControl(brake=1.0))
        self._session.tick()
        blueprint = self._library.find("controller.ai.walker")
        for walker in self.walkers:
            controller = self._session.spawn(blueprint, carla_package().Transform(), parent=walker)
            self._session.stop_first(controller)
            controller.start()
            goal = self._session.world.get_random_location_from_navigation()
            if goal is not None:
                controller.go_to_location(goal)
            controller.set_max_speed(WALKING)
        for _ in range(SETTLING - 1):
            self._session.tick()
        self.collisions.take()

    # Moving.
    def move_followers(self, poses: Iterable[Pose]) -> None:
        """Put the followers' middles where the platoon says."""
        for actor, pose in zip(self.followers, poses, strict=True):
            height = self._height(pose[0], pose[1])
            actor.set_transform(origin_of(pose, actor.bounding_box, height))

    def remove(self, other: Other) -> None:
        """Take whom the AV hit off the road, unless it is a follower or part of the town."""
        for actors in (self.traffic, self.walkers, self.props):
            for actor in [a for a in actors if a is not None and (a.id, a.type_id) == other]:
                actors.remove(actor)
                self._session.destroy(actor)

    # Reading.
    def read_av(self) -> Body:
        """The AV now."""
        return self._body("vehicle", self.av)

    def read_others(self) -> list[Body]:
        """Traffic, pedestrians and obstacles now."""
        kinds = (("vehicle", self.traffic), ("walker", self.walkers), ("prop", self.props))
        return [
            self._body(kind, actor)
            for kind, actors in kinds
            for actor in actors
            if actor is not None
        ]

    def _body(self, kind: str, actor: Any) -> Body:
        velocity = actor.get_velocity()
        speed = math.hypot(velocity.x, velocity.y)
        before = self._speeds.get(actor.id, speed)
        self._speeds[actor.id] = speed
        pose = centre_of(actor.get_transform(), actor.bounding_box)
        return Body(kind, pose, speed, (speed - before) / TIME_STEP, *_size(actor.bounding_box))


def _is_car(blueprint: Any) -> bool:
    if not blueprint.has_attribute("base_type"):
        return False
    return str(blueprint.get_attribute("base_type").as_str()) == "car"


def _size(box: Any) -> tuple[float, float]:
    """Length and width [m]; some of CARLA's props have boxes without a size."""
    length, width = (
        2 * half if 0.05 < half < 20.0 else 0.5 for half in (box.extent.x, box.extent.y)
    )
    return length, width
