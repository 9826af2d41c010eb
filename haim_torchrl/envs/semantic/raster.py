"""A top-down semantic image around the AV: the paper's second kind of observation.

Nothing here knows a simulator. One hands over the road once per episode (:class:`RoadLayers`) and
boxes at each step, both in the frame of recordings (:mod:`haim_torchrl.evaluation.recording`):
metres, y to the left, headings counter-clockwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import pygame
from numpy.typing import NDArray

from haim_torchrl.envs.semantic.pixels import draw_boxes, sample

Points = NDArray[np.float64]

CHANNELS = ("road", "lane", "vehicles", "obstacles", "route")
"""What the channels of an image show, in their order."""
ROAD, LANE, VEHICLES, OBSTACLES, ROUTE = range(len(CHANNELS))
FINENESS = 4
"""Pixels of the drawn map along one pixel of the image."""
LARGEST = 8192
"""The drawn map has at most this many pixels along a side; a larger road is drawn coarser."""


@dataclass(frozen=True)
class SemanticConfig:
    """What the image shows, and how finely.

    Attributes:
        size: pixels along each side; 84 and 42 are the paper's.
        reach: from the AV's centre to the front edge of the image [m].
        behind: from the AV's centre to the rear edge [m]. The image is a square, so it shows
            (reach + behind) / 2 to the left and as much to the right.
    """

    size: int = 84
    reach: float = 40.0
    behind: float = 20.0

    def __post_init__(self) -> None:
        if self.size < 8:
            raise ValueError(f"size: must be at least 8 pixels, got {self.size}")
        if not self.reach > 0:
            raise ValueError(f"reach: must be positive [m], got {self.reach}")
        if not self.behind >= 0:
            raise ValueError(f"behind: must not be negative [m], got {self.behind}")

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> SemanticConfig | None:
        """Settings from those of an observation, ``view`` among them.

        Args:
            settings: the group ``env.observation`` of any simulator.

        Returns:
            The settings; None unless ``view`` is ``"semantic"``.

        Raises:
            ValueError: an unknown key.
        """
        if settings.get("view") != "semantic":
            return None
        given = {key: value for key, value in settings.items() if key != "view"}
        known = [entry.name for entry in fields(cls)]
        unknown = sorted(set(given) - set(known))
        if unknown:
            raise ValueError(
                f"env.observation: the semantic view has no setting {unknown[0]!r}, only {known}; "
                "choose it with env/observation=semantic, which replaces all of them"
            )
        return cls(**given)

    @property
    def side(self) -> float:
        """Length of the square that the image shows [m]."""
        return self.reach + self.behind

    @property
    def pixel(self) -> float:
        """Side of a pixel [m]."""
        return self.side / self.size

    @property
    def shape(self) -> tuple[int, int, int]:
        """Channels, rows and columns of an image."""
        return len(CHANNELS), self.size, self.size


@dataclass(frozen=True)
class RoadLayers:
    """The parts of the image that stay the same within an episode.

    Attributes:
        surfaces: what may be driven on, as polygons [P, 2] that may overlap.
        lines: markings and edges, as polylines [P, 2].
        route: the way to the destination, as polygons [P, 2] that may overlap.

    :func:`band` makes polygons from a centre line and a width.
    """

    surfaces: Sequence[Points] = field(default_factory=list)
    lines: Sequence[Points] = field(default_factory=list)
    route: Sequence[Points] = field(default_factory=list)


def band(points: Points, width: float, piece: int = 16) -> list[Points]:
    """A strip along a line as polygons that fit together.

    Several, because a polygon that crosses itself, such as that of a whole route with a loop in
    it, has holes.

    Args:
        points: the middle, [P, 2], in m.
        width: of the strip [m].
        piece: segments of the line in one polygon.

    Returns:
        Polygons [<= 2 (piece + 1), 2]; none for fewer than two points.
    """
    points = np.asarray(points, dtype=float)
    if len(points) < 2:
        return []
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    left = along[:, ::-1] * [-1.0, 1.0] * width / 2
    return [
        np.concatenate(
            [(points + left)[k : k + piece + 1], (points - left)[k : k + piece + 1][::-1]]
        )
        for k in range(0, len(points) - 1, piece)
    ]


class SemanticRaster:
    """Draws the images of one episode.

    The road is drawn once as a map; an image samples it around the AV and adds the boxes of that
    moment. A value is 255 times the share of the pixel that is covered: with 1.4 m per pixel
    black-and-white edges would place the AV in its lane to a metre only. Lines are drawn as wide
    as a pixel, and boxes at least so, that none fades. The AV itself is not drawn: it would be the
    same in every image.

    Args:
        config: size and reach.
        layers: the road.

    Raises:
        ValueError: if a polygon or line is not [P, 2].
    """

    def __init__(self, config: SemanticConfig, layers: RoadLayers) -> None:
        self.config = config
        for name in ("surfaces", "lines", "route"):
            for points in getattr(layers, name):
                if np.ndim(points) != 2 or np.shape(points)[1] != 2:
                    raise ValueError(f"{name}: points must be [P, 2], got {np.shape(points)}")
        corners = [np.asarray(p) for p in (*layers.surfaces, *layers.lines, *layers.route)]
        everything = np.concatenate([*corners, np.zeros((0, 2))])
        low, high = np.zeros(2), np.zeros(2)
        if len(everything):
            low, high = everything.min(0) - config.pixel, everything.max(0) + config.pixel
        step = max(config.pixel / FINENESS, float((high - low).max()) / LARGEST)
        self._low, self._cell = low, 2 * step
        width, height = (2 * np.ceil((high - low) / self._cell).astype(int) + 2).tolist()
        lines = [quad for line in layers.lines for quad in band(line, config.pixel)]
        self._map = np.zeros((width // 2, height // 2, 4), dtype=np.uint8)
        for k, part in enumerate((layers.surfaces, lines, layers.route)):
            polygons = [(np.asarray(polygon) - low) / step for polygon in part]
            self._map[:, :, k] = _fill(polygons, width, height)

    def draw(
        self, pose: Sequence[float] | Points, vehicles: Points, obstacles: Points
    ) -> NDArray[np.uint8]:
        """The image of a moment.

        Args:
            pose: the AV's centre and heading (x [m], y [m], heading [rad]).
            vehicles: boxes of the other vehicles, [M, 5], with the columns of
                :data:`~haim_torchrl.evaluation.recording.BOX_FIELDS`.
            obstacles: boxes of obstacles, [K, 5].

        Returns:
            An image [5, size, size], rows from the front to the rear, columns from the left to
            the right, channels as in :data:`CHANNELS`.
        """
        config = self.config
        x, y, heading = float(pose[0]), float(pose[1]), float(pose[2])
        image = np.zeros(config.shape, dtype=np.uint8)
        view = (x, y, heading, config.reach, config.pixel)
        ground = image[ROAD], image[LANE], image[ROUTE]
        sample(*ground, view, self._map, self._low[0], self._low[1], self._cell)
        draw_boxes(image[VEHICLES], view, np.asarray(vehicles, dtype=float))
        draw_boxes(image[OBSTACLES], view, np.asarray(obstacles, dtype=float))
        return image


def _fill(polygons: Sequence[Points], width: int, height: int) -> NDArray[np.uint8]:
    """Polygons as shares of covered cells, [width / 2, height / 2]; points in half cells."""
    surface = pygame.Surface((width, height), depth=8)
    for polygon in polygons:
        # A pixel stands for its middle, and pygame fills up to and including the border.
        pygame.draw.polygon(surface, 1, np.rint(polygon - 0.5).astype(int).tolist())
    filled = pygame.surfarray.pixels2d(surface)
    columns = filled[::2] + filled[1::2]
    return np.array([0, 64, 128, 191, 255], dtype=np.uint8)[columns[:, ::2] + columns[:, 1::2]]
