"""The semantic image and the speed as the observation of any simulator that can be recorded."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.envs.semantic.raster import RoadLayers, SemanticConfig, SemanticRaster
from haim_torchrl.evaluation.recording import Snapshot

SPEED = 15.0
"""A speed of this [m/s] is seen as 1."""


class SemanticObserver:
    """What the agent sees where it has eyes: the paper's second observation.

    A simulator keeps one, gives it the road at each reset, and a snapshot at each step.

    Args:
        config: size and reach of the image.
    """

    def __init__(self, config: SemanticConfig) -> None:
        self.config = config
        self._raster: SemanticRaster | None = None

    @property
    def space(self) -> spaces.Dict:
        """``pixels`` [5, S, S], uint8, and ``state`` [1], float32: speed / 15 m/s."""
        return spaces.Dict(
            {
                "pixels": spaces.Box(0, 255, self.config.shape, np.uint8),
                "state": spaces.Box(-np.inf, np.inf, (1,), np.float32),
            }
        )

    @property
    def reflection(self) -> Reflection:
        """What a mirror does: left and right of the image are exchanged, the steering's sign."""
        return Reflection(
            (), (), (1.0, -1.0), observation_keys=(), image_keys=("pixels", ("next", "pixels"))
        )

    def reset(self, layers: RoadLayers) -> None:
        """Begin an episode on a road."""
        self._raster = SemanticRaster(self.config, layers)

    def observe(self, scene: Snapshot) -> dict[str, NDArray[np.uint8] | NDArray[np.float32]]:
        """What the agent sees of a scene.

        Args:
            scene: all vehicles and obstacles, followers included.

        Returns:
            ``pixels`` [5, S, S] and ``state`` [1].

        Raises:
            RuntimeError: before the first :meth:`reset`.
        """
        if self._raster is None:
            raise RuntimeError("There is no road to look at yet; call reset(layers) first.")
        vehicles = np.concatenate([scene.followers, scene.traffic])
        return {
            "pixels": self._raster.draw(scene.vehicle[:3], vehicles, scene.obstacles),
            "state": np.array([scene.speed / SPEED], dtype=np.float32),
        }
