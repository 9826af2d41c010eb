"""Scenarios: everything that a seed decides before the first step.

A scenario is the X of X+1+N: the road (a random chain of blocks), the traffic, and the obstacles.
The same seed and settings give the same scenario.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from haim_torchrl.envs.blocks import BLOCKS, LANE_WIDTH, SideRoad
from haim_torchrl.envs.carriageway import Carriageway
from haim_torchrl.envs.path import Path, Piece, draw

START = 115.0
"""Arc length at which the AV starts [m]: room for the platoon behind it."""
RUN_UP, RUN_OUT = 145.0, 30.0
"""Straight road before the first and after the last block [m]."""

OBSTACLES = ("cones", "triangle", "stopped", "slow")
"""Kinds of obstacles: a row of cones, a warning triangle before a broken-down vehicle, a
broken-down vehicle, and one that crawls."""


@dataclass(frozen=True)
class ScenarioConfig:
    """What scenarios are drawn from.

    Attributes:
        blocks: weight of each block type in the mixture.
        block_count: blocks per route (the paper's maps have 3).
        lanes: possible numbers of lanes.
        traffic_density: route vehicles per 100 m of lane.
        side_traffic: mean number of vehicles on each side road.
        traffic_speed: range of desired speeds of traffic [m/s].
        obstacles: probabilities of 0, 1, 2, ... obstacles per route.
        obstacle_kinds: weight of each kind of obstacle.
    """

    blocks: Mapping[str, float] = field(default_factory=lambda: dict.fromkeys(BLOCKS, 1.0))
    block_count: int = 3
    lanes: tuple[int, ...] = (2, 3)
    traffic_density: float = 1.0
    side_traffic: float = 1.0
    traffic_speed: tuple[float, float] = (6.0, 9.0)
    obstacles: tuple[float, ...] = (0.2, 0.5, 0.3)
    obstacle_kinds: Mapping[str, float] = field(
        default_factory=lambda: dict.fromkeys(OBSTACLES, 1.0)
    )

    def __post_init__(self) -> None:
        unknown = set(self.blocks) - set(BLOCKS)
        if unknown:
            raise ValueError(f"blocks: unknown {sorted(unknown)}; choose from {sorted(BLOCKS)}")
        _check_weights("blocks", self.blocks)
        if self.block_count < 1:
            raise ValueError(f"block_count: must be at least 1, got {self.block_count}")
        if not self.lanes or any(lane not in (2, 3) for lane in self.lanes):
            raise ValueError(f"lanes: choose 2 and/or 3, got {list(self.lanes)}")
        if self.traffic_density < 0 or self.side_traffic < 0:
            raise ValueError("traffic_density and side_traffic: must not be negative")
        if len(self.traffic_speed) != 2 or not 0 < self.traffic_speed[0] <= self.traffic_speed[1]:
            raise ValueError(
                "traffic_speed: must be two speeds, the lower one first and positive, "
                f"got {list(self.traffic_speed)}"
            )
        unknown = set(self.obstacle_kinds) - set(OBSTACLES)
        if unknown:
            raise ValueError(
                f"obstacle_kinds: unknown {sorted(unknown)}; choose from {sorted(OBSTACLES)}"
            )
        _check_weights("obstacle_kinds", self.obstacle_kinds)
        if abs(sum(self.obstacles) - 1.0) > 1e-6 or min(self.obstacles) < 0:
            raise ValueError(f"obstacles: probabilities must sum to 1, got {list(self.obstacles)}")


def _check_weights(name: str, weights: Mapping[str, float]) -> None:
    if min(weights.values(), default=0.0) < 0 or not any(w > 0 for w in weights.values()):
        raise ValueError(f"{name}: weights must not be negative, and at least one positive")


@dataclass(frozen=True)
class Spawn:
    """A traffic vehicle that enters when the AV comes near.

    Attributes:
        s: arc length on its path [m].
        speed: desired speed [m/s].
        lane: lane of the route it drives in, or None on a side road.
        side: index of its side road, or None.
        trigger: the AV's arc length on the route [m] at which it enters.
        patience: time gap [s] that it leaves to vehicles with priority.
    """

    s: float
    speed: float
    lane: int | None
    side: int | None
    trigger: float
    patience: float = 5.0


@dataclass(frozen=True)
class ObstaclePlacement:
    """An obstacle that closes one lane: kind, arc length on the route [m], lane."""

    kind: str
    s: float
    lane: int


@dataclass(frozen=True)
class Scenario(Carriageway):
    """A road with its traffic and obstacles.

    Attributes:
        seed: what it was drawn from.
        blocks: kinds of the blocks with the arc lengths [m] where they start and end.
        sides: side roads.
        spawns: traffic.
        obstacles: obstacles.
    """

    seed: int
    blocks: tuple[tuple[str, float, float], ...]
    sides: tuple[SideRoad, ...]
    spawns: tuple[Spawn, ...]
    obstacles: tuple[ObstaclePlacement, ...]


def generate_scenario(seed: int, config: ScenarioConfig) -> Scenario:
    """Draw the scenario of a seed."""
    rng = np.random.default_rng(seed)
    lanes = int(rng.choice(config.lanes))
    kinds = [kind for kind, weight in config.blocks.items() if weight > 0]
    weights = np.array([config.blocks[kind] for kind in kinds])
    while True:
        chain = [
            BLOCKS[str(rng.choice(kinds, p=weights / weights.sum()))](rng, lanes)
            for _ in range(config.block_count)
        ]
        pieces = [Piece(RUN_UP), *(p for block in chain for p in block.pieces), Piece(RUN_OUT)]
        route = draw(pieces)
        if not _meets_itself(route):
            break
    starts = RUN_UP + np.concatenate([[0.0], np.cumsum([block.length for block in chain])])
    blocks = tuple(
        (block.kind, float(a), float(b))
        for block, a, b in zip(chain, starts[:-1], starts[1:], strict=True)
    )
    sides = tuple(
        side
        for block, start in zip(chain, starts[:-1], strict=True)
        for side in block.sides(route, float(start), lanes)
        if not _meets_elsewhere(side, route, float(start) - 20, float(start) + block.length + 20)
    )
    free = [
        (float(a) + 10.0, float(b) - 5.0)
        for block, a, b in zip(chain, starts[:-1], starts[1:], strict=True)
        if block.open_road
    ]
    obstacles = _place_obstacles(rng, config, free, lanes)
    spawns = _place_traffic(rng, config, route, lanes, sides, obstacles)
    return Scenario(route, lanes, LANE_WIDTH, seed, blocks, sides, spawns, obstacles)


def _place_obstacles(
    rng: np.random.Generator,
    config: ScenarioConfig,
    free: list[tuple[float, float]],
    lanes: int,
) -> tuple[ObstaclePlacement, ...]:
    count = int(rng.choice(len(config.obstacles), p=np.array(config.obstacles)))
    if not free:
        return ()
    kinds = list(config.obstacle_kinds)
    weights = np.array([config.obstacle_kinds[kind] for kind in kinds])
    placed: list[ObstaclePlacement] = []
    lengths = np.array([b - a for a, b in free])
    for _ in range(10 * count):
        if len(placed) == count:
            break
        a, b = free[int(rng.choice(len(free), p=lengths / lengths.sum()))]
        s = rng.uniform(a, b)
        if all(abs(s - other.s) > 60.0 for other in placed):
            kind = str(rng.choice(kinds, p=weights / weights.sum()))
            placed.append(ObstaclePlacement(kind, float(s), int(rng.integers(lanes))))
    return tuple(sorted(placed, key=lambda obstacle: obstacle.s))


def _place_traffic(
    rng: np.random.Generator,
    config: ScenarioConfig,
    route: Path,
    lanes: int,
    sides: tuple[SideRoad, ...],
    obstacles: tuple[ObstaclePlacement, ...],
) -> tuple[Spawn, ...]:
    spawns: list[Spawn] = []
    for lane in range(lanes):
        leaves = [k for k, side in enumerate(sides) if side.leaves_from == lane]
        s = START + 25.0 + rng.exponential(20.0)
        while config.traffic_density > 0 and s < route.length - 20.0:
            blocked = any(o.lane == lane and abs(o.s - s) < 20.0 for o in obstacles)
            if not blocked:
                speed = float(rng.uniform(*config.traffic_speed))
                ahead = [k for k in leaves if sides[k].surface[0] > s + 10.0]
                leaving = int(rng.choice(ahead)) if ahead and rng.random() < 0.4 else None
                own = lane if leaving is None else None
                spawns.append(Spawn(float(s), speed, own, leaving, float(s) - 70.0))
            s += 14.0 + rng.exponential(max(100.0 / config.traffic_density - 14.0, 1.0))
    for k, side in enumerate(sides):
        if side.conflict is None or side.give_way_at is None:
            continue
        for place in range(int(rng.poisson(config.side_traffic))):
            back = side.give_way_at - rng.uniform(5.0, 20.0) - 15.0 * place
            if back > 3.0:
                speed = float(rng.uniform(*config.traffic_speed))
                trigger = side.conflict[0] - rng.uniform(60.0, 75.0)
                patience = float(rng.choice([5.0, 3.0], p=[0.8, 0.2]))
                spawns.append(Spawn(float(back), speed, None, k, float(trigger), patience))
    return tuple(sorted(spawns, key=lambda spawn: spawn.trigger))


def _meets_itself(route: Path, clearance: float = 40.0, apart: int = 90) -> bool:
    x, y = route.x[::4], route.y[::4]
    gap = np.hypot(x[:, None] - x[None, :], y[:, None] - y[None, :])
    index = np.arange(len(x)) * 4
    far = np.abs(index[:, None] - index[None, :]) > apart
    return bool((far & (gap < clearance)).any())


def _meets_elsewhere(side: SideRoad, route: Path, start: float, end: float) -> bool:
    """Whether the pavement of a side road touches the route outside its own block."""
    surface = side.path.part(*side.surface)
    for x, y in zip(surface.x[::3], surface.y[::3], strict=True):
        s, d = route.project((x, y))
        if abs(d) < 14.0 and 0.0 < s < route.length and not start <= s <= end:
            return True
    return False
