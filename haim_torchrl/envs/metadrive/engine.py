"""MetaDrive's engine: made with our settings, one per process, headless without its assets."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator
from typing import Any

from metadrive.component.map.base_map import BaseMap
from metadrive.component.pgblock.first_block import FirstPGBlock
from metadrive.constants import DEFAULT_AGENT
from metadrive.engine.asset_loader import AssetLoader
from metadrive.engine.base_engine import BaseEngine
from metadrive.engine.engine_utils import engine_initialized
from metadrive.envs import MetaDriveEnv

from haim_torchrl.envs.metadrive.config import MetaDriveConfig, MetaDriveObservation
from haim_torchrl.envs.metadrive.followers import FollowerManager

ENTRANCE = FirstPGBlock.ENTRANCE_LENGTH
"""Length of the first of the two roads of the first block [m]."""
AHEAD = 45.0
"""Length of the first block that lies ahead of the AV at its start [m], as in MetaDrive."""
TAIL = 6.0
"""Room behind the last follower's centre [m]."""


def room_behind(settings: MetaDriveConfig) -> float:
    """Length of road that the followers need behind the AV [m]."""
    return settings.followers * (settings.follower_gap + FollowerManager.LENGTH) + TAIL


def translate(settings: MetaDriveConfig) -> dict[str, Any]:
    """Our settings in MetaDrive's words.

    The first block is made longer than MetaDrive's 50 m by what the followers need. Maps and
    traffic depend on the seed alone and stay what they are.
    """
    behind = room_behind(settings)
    return {
        "start_seed": settings.first_scenario,
        "num_scenarios": settings.scenarios,
        "map_config": {
            BaseMap.GENERATE_TYPE: "block_num",
            BaseMap.GENERATE_CONFIG: settings.blocks,
            BaseMap.LANE_NUM: settings.lanes,
            BaseMap.LANE_WIDTH: settings.lane_width,
            "exit_length": ENTRANCE + behind + AHEAD,
        },
        "agent_configs": {
            DEFAULT_AGENT: {
                "use_special_color": True,
                "spawn_lane_index": (FirstPGBlock.NODE_2, FirstPGBlock.NODE_3, 0),
                "spawn_longitude": behind,
            }
        },
        "random_spawn_lane_index": True,  # of the road above, by the scenario's seed
        "traffic_density": settings.traffic_density,
        "accident_prob": settings.accident_probability,
        "horizon": settings.horizon,
        "out_of_route_done": True,
        "crash_vehicle_done": settings.end_on_collision,
        "crash_object_done": settings.end_on_collision,
        "success_reward": 20.0,
        # The paper's reward is progress, speed and arrival; costs are a matter of their own.
        "out_of_road_penalty": 0.0,
        "crash_vehicle_penalty": 0.0,
        "crash_object_penalty": 0.0,
        "store_map": settings.cached_maps,
        # Vehicles used again bring something of their last episode along: without this, scenario k
        # depended on which scenarios came before it.
        "num_buffering_objects": 0,
        "vehicle_config": {"lidar": _lasers(settings)},
        "use_render": settings.render == "3d",
        "log_level": logging.ERROR,
    }


def _lasers(settings: MetaDriveConfig) -> dict[str, Any]:
    """MetaDrive's lasers, if they are what the agent sees; none save their time."""
    seen = settings.observation
    count = seen.rays if isinstance(seen, MetaDriveObservation) and seen.view == "rays" else 0
    return {"num_lasers": count, "distance": 50.0 if count == 0 else seen.reach, "num_others": 0}


class PlatoonMetaDrive(MetaDriveEnv):
    """MetaDrive's environment with followers behind the AV.

    Args:
        settings: settings of the world.
    """

    def __init__(self, settings: MetaDriveConfig) -> None:
        self.settings = settings
        super().__init__(translate(settings))

    def lazy_init(self) -> None:
        """Start the engine, unless it runs already."""
        with contextlib.nullcontext() if _has_assets() else _without_download():
            super().lazy_init()

    def setup_engine(self) -> None:
        """MetaDrive's managers, and one that moves the followers."""
        super().setup_engine()
        self.engine.register_manager("follower_manager", FollowerManager(self.settings))


def open_engine(settings: MetaDriveConfig) -> PlatoonMetaDrive:
    """Start the engine in this process.

    Raises:
        RuntimeError: this process has one already, or a window is wanted and assets are missing.
    """
    if engine_initialized():
        raise RuntimeError(
            "MetaDrive runs one engine in a process and this process has one already; close that "
            "environment first, or give each a process of its own (collector=parallel, "
            "eval.workers=1)"
        )
    if settings.render == "3d" and not _has_assets():
        raise RuntimeError(
            "env.render=3d needs MetaDrive's assets, which are not installed; get them with "
            "python -m metadrive.pull_asset, or use env.render=none"
        )
    env = PlatoonMetaDrive(settings)
    env.lazy_init()
    return env


def _has_assets() -> bool:
    return os.path.exists(AssetLoader.asset_path)


@contextlib.contextmanager
def _without_download() -> Iterator[None]:
    """Keeps the engine from fetching 3-D models on its start, which headless runs never load."""
    original = BaseEngine.try_pull_asset
    BaseEngine.try_pull_asset = staticmethod(lambda: None)
    try:
        yield
    finally:
        BaseEngine.try_pull_asset = staticmethod(original)
