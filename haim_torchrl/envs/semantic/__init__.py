"""The visual observation: a top-down semantic image around the AV, for any simulator."""

from haim_torchrl.envs.semantic.observation import SemanticObserver
from haim_torchrl.envs.semantic.raster import (
    CHANNELS,
    RoadLayers,
    SemanticConfig,
    SemanticRaster,
    band,
)

__all__ = ["CHANNELS", "RoadLayers", "SemanticConfig", "SemanticObserver", "SemanticRaster", "band"]
