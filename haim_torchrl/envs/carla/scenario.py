"""What a seed stands for: a route through a town, obstacles on it, and where traffic starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haim_torchrl.envs.carla.config import CarlaConfig
from haim_torchrl.envs.carla.frames import Pose
from haim_torchrl.envs.carla.map.route import Route, draw_route
from haim_torchrl.envs.carla.map.town import Town
from haim_torchrl.envs.vehicles import FollowerVehicle

PROPS = (
    "static.prop.trafficcone01",
    "static.prop.trafficwarning",
    "static.prop.streetbarrier",
)
"""Blueprints of obstacles."""
CLEAR = 40.0
"""No obstacle stands this near to the start or the destination [m]."""
ROOM = 12.0
"""Traffic starts this far from the platoon, at least [m]."""
SPACING = 15.0
"""Distance of the places where traffic may start [m]."""


@dataclass(frozen=True)
class CarlaScenario:
    """One scenario.

    Attributes:
        seed: what it was drawn from.
        town: name of the town.
        route: the way, the part that the followers stand on at the start included.
        start: arc length at which the AV stands [m].
        obstacles: blueprint and pose of each.
        places: where traffic may start, in the order in which it does.
    """

    seed: int
    town: str
    route: Route
    start: float
    obstacles: tuple[tuple[str, Pose], ...]
    places: tuple[Pose, ...]


def draw_scenario(town: Town, seed: int, config: CarlaConfig) -> CarlaScenario:
    """Draw the scenario of a seed; the same map, seed and settings give the same one.

    Raises:
        ValueError: no such seed, or the town has no way as long as `config.route_length`.
    """
    name = config.town(seed)
    rng = np.random.default_rng(seed)
    run_up = float(np.ceil(config.followers * (config.follower_gap + FollowerVehicle.LENGTH) + 5.0))
    route = draw_route(town.lanes, rng, run_up, config.route_length)
    path = route.path
    chances = np.array(config.obstacles) / np.sum(config.obstacles)
    count = int(rng.choice(len(chances), p=chances))
    arcs = np.sort(rng.uniform(run_up + CLEAR, max(path.length - CLEAR, run_up + CLEAR), count))
    obstacles = tuple(
        (str(rng.choice(PROPS)), path.at(float(s), config.obstacle_offset)) for s in arcs
    )
    near = np.stack([path.x, path.y], axis=1)[: int(run_up + ROOM) + 1]
    taken = np.concatenate([near, [pose[:2] for _, pose in obstacles] or np.zeros((0, 2))])
    places = town.places(SPACING)
    free = [
        places[k]
        for k in rng.permutation(len(places)).tolist()
        if np.hypot(*(taken - places[k][:2]).T).min() > ROOM
    ]
    return CarlaScenario(seed, name, route, run_up, obstacles, tuple(free))
