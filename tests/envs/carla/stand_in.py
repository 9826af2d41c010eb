"""A stand-in for a CARLA server, which cannot run here: its world, clock and actors in memory.

Maps, waypoints, transforms, settings and controls are those of the real client package. Cars are
kinematic bicycles without tyres, gears or suspension, traffic follows its lane at 6 m/s, and boxes
that overlap collide without any force. As with a server, an actor is seen where it was after the
last tick, and time passes in ticks alone.
"""

from __future__ import annotations

import math
from fnmatch import fnmatch
from types import SimpleNamespace

import pytest

from haim_torchrl.envs.geometry import overlaps

carla = pytest.importorskip("carla")

FULL_LOCK = 70.0
"""Front-wheel angle at steer = 1 [degrees]."""
SIZES = {"vehicle": (2.4, 0.95), "walker": (0.2, 0.2), "static": (0.3, 0.2)}
"""Half lengths and half widths [m]."""
BLUEPRINTS = {
    "vehicle.tesla.model3": {"role_name": "", "base_type": "car"},
    "vehicle.audi.a2": {"role_name": "", "base_type": "car"},
    "vehicle.bh.crossbike": {"role_name": "", "base_type": "bicycle"},
    "walker.pedestrian.0001": {"is_invincible": "true"},
    "controller.ai.walker": {},
    "sensor.other.collision": {},
    "static.prop.trafficcone01": {},
    "static.prop.trafficwarning": {},
    "static.prop.streetbarrier": {},
}


class Server:
    """One server.

    Attributes:
        version: what it says of itself.
        answers: whether it answers at all.
        calls: names of the calls that matter for order, as they came.
    """

    def __init__(self, opendrive: str, towns=("Town01", "Town02")) -> None:
        self.version, self.answers, self.calls = "0.9.16", True, []
        self._maps = {town: carla.Map(town, opendrive) for town in (*towns, "Town03")}
        self.towns = list(towns)
        self.settings = carla.WorldSettings()
        self.managers: dict[int, Manager] = {}
        self.world = World(self, "Town03")

    def client(self, host: str, port: int) -> Client:
        """What ``carla.Client(host, port)`` would be."""
        return Client(self, host, port)

    def map(self, town: str) -> carla.Map:
        return self._maps[town]

    @property
    def alive(self) -> list[Actor]:
        return [actor for actor in self.world.actors if actor.is_alive]


class Client:
    def __init__(self, server: Server, host: str, port: int) -> None:
        self._server, self._address = server, f"{host}:{port}"
        self._timeout = 5.0

    def set_timeout(self, seconds: float) -> None:
        self._timeout = seconds

    def get_client_version(self) -> str:
        return "0.9.16"

    def get_server_version(self) -> str:
        self._ask()
        return self._server.version

    def get_available_maps(self) -> list[str]:
        return [f"/Game/Carla/Maps/{town}" for town in self._server.towns]

    def get_world(self) -> World:
        self._ask()
        return self._server.world

    def load_world(self, town: str) -> World:
        self._server.calls.append(f"load {town}")
        self._server.settings = carla.WorldSettings()
        self._server.world = World(self._server, town)
        return self._server.world

    def get_trafficmanager(self, port: int) -> Manager:
        return self._server.managers.setdefault(port, Manager())

    def _ask(self) -> None:
        if not self._server.answers:
            raise RuntimeError(f"time-out of {self._timeout * 1000:.0f}ms ... {self._address}")


class Manager:
    def __init__(self) -> None:
        self.synchronous, self.seed, self.ignoring = False, None, []

    def set_synchronous_mode(self, on: bool) -> None:
        self.synchronous = on

    def set_random_device_seed(self, seed: int) -> None:
        self.seed = seed

    def ignore_lights_percentage(self, actor: Actor, percentage: float) -> None:
        self.ignoring.append((actor.id, percentage))


class World:
    def __init__(self, server: Server, town: str) -> None:
        self._server, self._town = server, town
        self.actors: list[Actor] = []
        self.frame = 100

    def get_map(self) -> carla.Map:
        return self._server.map(self._town)

    def get_settings(self) -> carla.WorldSettings:
        now = self._server.settings  # a copy, as from a server
        return carla.WorldSettings(
            synchronous_mode=now.synchronous_mode,
            no_rendering_mode=now.no_rendering_mode,
            fixed_delta_seconds=now.fixed_delta_seconds or 0.0,
        )

    def apply_settings(self, settings: carla.WorldSettings) -> int:
        if not self._server.answers:
            raise RuntimeError("time-out")
        self._server.calls.append(f"synchronous {settings.synchronous_mode}")
        self._server.settings = settings
        return self.frame

    def set_pedestrians_seed(self, seed: int) -> None:
        self._server.calls.append(f"pedestrians {seed}")

    def get_blueprint_library(self) -> Library:
        return Library()

    def get_random_location_from_navigation(self) -> carla.Location:
        return carla.Location(x=50.0 + 2 * len(self.actors), y=5.0)

    def try_spawn_actor(self, blueprint, transform, attach_to=None) -> Actor | None:
        actor = Actor(self, blueprint, transform, attach_to)
        solid = [other for other in self.actors if other.is_alive and other.solid]
        if actor.solid and any(actor.touches(other) for other in solid):
            return None
        self.actors.append(actor)
        return actor

    def tick(self) -> int:
        if not self._server.answers:
            raise RuntimeError("time-out")
        settings = self._server.settings
        assert settings.synchronous_mode, "only a synchronous world waits for ticks"
        self.frame += 1
        alive = [actor for actor in self.actors if actor.is_alive]
        for actor in alive:
            actor.move(settings.fixed_delta_seconds)
        for sensor in [actor for actor in alive if actor.callback is not None]:
            for other in alive:
                if other.solid and other is not sensor.parent and sensor.parent.touches(other):
                    event = SimpleNamespace(frame=self.frame, other_actor=other)
                    sensor.callback(event)
        return self.frame


class Library:
    def find(self, name: str) -> Blueprint:
        return Blueprint(name)

    def filter(self, pattern: str) -> list[Blueprint]:
        return [Blueprint(name) for name in reversed(BLUEPRINTS) if fnmatch(name, pattern)]


class Blueprint:
    def __init__(self, name: str) -> None:
        self.id, self.attributes = name, dict(BLUEPRINTS[name])

    def has_attribute(self, name: str) -> bool:
        return name in self.attributes

    def get_attribute(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(as_str=lambda: self.attributes[name])

    def set_attribute(self, name: str, value: str) -> None:
        assert name in self.attributes, f"{self.id} has no {name}"
        self.attributes[name] = value


class Actor:
    """A vehicle, pedestrian, prop, sensor or controller."""

    numbers = 0

    def __init__(self, world: World, blueprint: Blueprint, transform, parent) -> None:
        Actor.numbers += 1
        self.id, self.type_id, self.attributes = Actor.numbers, blueprint.id, blueprint.attributes
        self._world, self.parent = world, parent
        kind = self.type_id.split(".")[0]
        self.solid = kind in SIZES
        half_length, half_width = SIZES.get(kind, (0.0, 0.0))
        # The box's middle is ahead of the origin, as with some of CARLA's cars.
        self.bounding_box = carla.BoundingBox(
            carla.Location(x=0.1 if kind == "vehicle" else 0.0, z=0.7),
            carla.Vector3D(half_length, half_width, 0.7),
        )
        at = transform.location
        self._x, self._y, self._yaw = at.x, at.y, math.radians(transform.rotation.yaw)
        self._speed = 0.0
        self._seen = carla.Transform()  # as a server's, until the first tick
        self._control = carla.VehicleControl()
        self.physics, self.autopilot, self.callback = True, False, None
        self.is_alive, self.started, self.stopped = True, False, False

    # What the client's actors offer.
    def get_transform(self) -> carla.Transform:
        self._check()
        return self._seen

    def get_velocity(self) -> carla.Vector3D:
        self._check()
        return carla.Vector3D(
            self._speed * math.cos(self._yaw), self._speed * math.sin(self._yaw), 0.0
        )

    def get_physics_control(self) -> carla.VehiclePhysicsControl:
        control = carla.VehiclePhysicsControl()
        front = carla.WheelPhysicsControl(max_steer_angle=FULL_LOCK)
        rear = carla.WheelPhysicsControl(max_steer_angle=0.0)
        control.wheels = [front, front, rear, rear]
        return control

    def apply_control(self, control: carla.VehicleControl) -> None:
        self._check()
        self._control = control

    def set_transform(self, transform: carla.Transform) -> None:
        self._check()
        at = transform.location
        self._x, self._y, self._yaw = at.x, at.y, math.radians(transform.rotation.yaw)

    def set_simulate_physics(self, on: bool) -> None:
        self.physics = on

    def set_autopilot(self, on: bool, port: int) -> None:
        assert port in self._world._server.managers
        self.autopilot = on

    def listen(self, callback) -> None:
        self.callback = callback

    def start(self) -> None:
        self.started = True

    def go_to_location(self, location: carla.Location) -> None:
        assert self.started

    def set_max_speed(self, speed: float) -> None:
        assert self.started

    def stop(self) -> None:
        self._check()
        self.stopped, self.callback = True, None

    def destroy(self) -> bool:
        self._check()
        self.is_alive = False
        return True

    def _check(self) -> None:
        if not self.is_alive or self._world is not self._world._server.world:
            raise RuntimeError("trying to operate on a destroyed actor")

    # What the server does.
    def push(self, speed: float) -> None:
        """Give a car a speed [m/s]."""
        self._speed = speed

    def move(self, dt: float) -> None:
        if self.type_id.startswith("vehicle.") and self.physics:
            if self.autopilot:
                self._follow_lane(6.0 * dt)
            else:
                self._drive(dt)
        location = carla.Location(x=self._x, y=self._y)
        self._seen = carla.Transform(location, carla.Rotation(yaw=math.degrees(self._yaw)))

    def _drive(self, dt: float) -> None:
        control = self._control
        speed = self._speed + (4.0 * control.throttle - 8.0 * control.brake) * dt
        self._speed = max(speed, 0.0)
        angle = math.radians(FULL_LOCK) * control.steer
        slip = math.atan(math.tan(angle) / 2)
        self._x += self._speed * math.cos(self._yaw + slip) * dt
        self._y += self._speed * math.sin(self._yaw + slip) * dt
        self._yaw += self._speed * math.sin(slip) / 1.45 * dt

    def _follow_lane(self, distance: float) -> None:
        place = self._world.get_map().get_waypoint(carla.Location(x=self._x, y=self._y))
        ahead = place.next(distance)
        if ahead:
            to = ahead[0].transform
            self._x, self._y = to.location.x, to.location.y
            self._yaw, self._speed = math.radians(to.rotation.yaw), 6.0

    def touches(self, other: Actor) -> bool:
        boxes = []
        for actor in (self, other):
            ahead, extent = actor.bounding_box.location.x, actor.bounding_box.extent
            x = actor._x + ahead * math.cos(actor._yaw)
            y = actor._y + ahead * math.sin(actor._yaw)
            boxes.append((x, y, actor._yaw, extent.x, extent.y))
        return overlaps(*boxes[0], *boxes[1])
