"""What the agent sees of MetaDrive: its own vector, the view along the route, or an image."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from gymnasium import spaces

from haim_torchrl.data.reflection import Reflection
from haim_torchrl.envs.metadrive.config import MetaDriveObservation
from haim_torchrl.envs.observation import observe
from haim_torchrl.envs.semantic import SemanticConfig, SemanticObserver

MOTION = slice(4, 8)
"""Where MetaDrive's vector has the steering, the last action (two numbers) and the yaw rate."""


class View(Protocol):
    """A way to see.

    Attributes:
        space: of what is seen.
        reflection: what a mirror does to it; None if it has no such symmetry.
    """

    @property
    def space(self) -> spaces.Space[Any]: ...

    @property
    def reflection(self) -> Reflection | None: ...

    def reset(self, simulator: Any) -> None:
        """Begin an episode."""

    def observe(self, simulator: Any, vector: np.ndarray) -> Any:
        """What is seen now; `vector` is MetaDrive's own."""
        ...


def make_view(seen: MetaDriveObservation | SemanticConfig, size: int) -> View:
    """The view for some settings; `size` is that of MetaDrive's own vector."""
    if isinstance(seen, SemanticConfig):
        return ImageView(seen)
    return RouteView(seen) if seen.view == "route" else VectorView(seen, size)


class VectorView:
    """MetaDrive's own vector, the paper's first observation."""

    reflection = None

    def __init__(self, seen: MetaDriveObservation, size: int) -> None:
        self.space = spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self._motion = seen.motion

    def reset(self, simulator: Any) -> None:
        """Nothing to begin."""

    def observe(self, simulator: Any, vector: np.ndarray) -> np.ndarray:
        """The vector, perhaps without what tells the agent's own motion."""
        if not self._motion:
            vector[MOTION] = 0.5
        return vector


class RouteView:
    """The default world's view along the route."""

    def __init__(self, seen: MetaDriveObservation) -> None:
        self._config = seen
        self.space = spaces.Box(-np.inf, np.inf, (self._config.size,), np.float32)
        self.reflection = None
        if seen.reflection is not None:  # None: the strips are lopsided
            self.reflection = Reflection(*seen.reflection, action_sign=(1.0, -1.0))

    def reset(self, simulator: Any) -> None:
        """Nothing to begin."""

    def observe(self, simulator: Any, vector: np.ndarray) -> np.ndarray:
        """See :func:`~haim_torchrl.envs.observation.observe`."""
        return observe(simulator.road, self._config)


class ImageView:
    """The semantic image and the speed, the paper's second observation."""

    def __init__(self, config: SemanticConfig) -> None:
        self._eyes = SemanticObserver(config)
        self.space, self.reflection = self._eyes.space, self._eyes.reflection

    def reset(self, simulator: Any) -> None:
        """Draw the episode's roads."""
        self._eyes.reset(simulator.road_layers())

    def observe(self, simulator: Any, vector: np.ndarray) -> dict[str, Any]:
        """The image and the speed."""
        return dict(self._eyes.observe(simulator.snapshot()))
