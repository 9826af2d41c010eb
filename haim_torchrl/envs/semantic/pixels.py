"""Compiled loops over the pixels of a semantic image.

A `view` is the AV's x, y [m] and heading [rad, counter-clockwise], the distance from it to the
image's front edge [m], and a pixel's side [m]. Row 0 is in front, column 0 on the left.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Image = NDArray[np.uint8]
View = tuple[float, float, float, float, float]


@njit(cache=True)
def sample(
    road: Image, lane: Image, route: Image, view: View, ground: Image,
    low_x: float, low_y: float, cell: float,
) -> None:  # fmt: skip
    """Fill channels of an image from a map, in between its cells linearly.

    Args:
        road, lane, route: channels of an image, [S, S], changed in place.
        view: see above.
        ground: the map, [W, H, 4], by x and y: road, lane, route, nothing; zero outside.
        low_x, low_y: the map's corner [m].
        cell: side of its cells [m].
    """
    x, y, heading, reach, pixel = view
    size = road.shape[0]
    width, height = ground.shape[0], ground.shape[1]
    cos, sin = np.cos(heading) / cell, np.sin(heading) / cell
    x, y = (x - low_x) / cell - 0.5, (y - low_y) / cell - 0.5
    for row in range(size):
        forward = reach - (row + 0.5) * pixel
        for column in range(size):
            left = (size / 2 - (column + 0.5)) * pixel
            u, v = x + cos * forward - sin * left, y + sin * forward + cos * left
            if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
                continue
            i, j = np.uint64(u), np.uint64(v)
            # In 256ths; integers are faster than floats here.
            a, b = np.int32(256 * (u - i)), np.int32(256 * (v - j))
            near, far = ground[i], ground[i + np.uint64(1)]
            first, second = near[j], near[j + np.uint64(1)]
            third, fourth = far[j], far[j + np.uint64(1)]
            w1, w2, w3, w4 = (256 - a) * (256 - b), (256 - a) * b, a * (256 - b), a * b
            for k, channel in enumerate((road, lane, route)):
                total = w1 * first[k] + w2 * second[k] + w3 * third[k] + w4 * fourth[k]
                channel[row, column] = np.uint8((total + 32768) >> 16)


@njit(cache=True)
def draw_boxes(channel: Image, view: View, boxes: NDArray[np.float64]) -> None:
    """Add boxes to a channel of an image: the share of each pixel that a box covers.

    The share is exact for boxes parallel to the image's sides. A box narrower than a pixel is
    drawn as wide as one.

    Args:
        channel: [S, S], changed in place.
        view: see above.
        boxes: x, y, heading, length, width of each, [M, 5].
    """
    x, y, heading, reach, pixel = view
    size = channel.shape[0]
    cos, sin = np.cos(heading), np.sin(heading)
    for m in range(boxes.shape[0]):
        dx, dy = boxes[m, 0] - x, boxes[m, 1] - y
        # Everything in pixels from here on; the middle in rows and columns.
        row0 = (reach - (cos * dx + sin * dy)) / pixel - 0.5
        column0 = size / 2 - (-sin * dx + cos * dy) / pixel - 0.5
        half_length = max(boxes[m, 3] / pixel, 1.0) / 2
        half_width = max(boxes[m, 4] / pixel, 1.0) / 2
        turn = boxes[m, 2] - heading
        c, s = np.cos(turn), np.sin(turn)
        rows = abs(c) * half_length + abs(s) * half_width + 1.0
        columns = abs(s) * half_length + abs(c) * half_width + 1.0
        first_row, last_row = max(int(row0 - rows), 0), min(int(row0 + rows) + 1, size - 1)
        first, last = max(int(column0 - columns), 0), min(int(column0 + columns) + 1, size - 1)
        for row in range(first_row, last_row + 1):
            for column in range(first, last + 1):
                ahead, left = row0 - row, column0 - column
                along, across = c * ahead + s * left, -s * ahead + c * left
                share = min(along + 0.5, half_length) - max(along - 0.5, -half_length)
                beside = min(across + 0.5, half_width) - max(across - 0.5, -half_width)
                if share > 0 and beside > 0:
                    value = np.uint8(255 * share * beside + 0.5)
                    channel[row, column] = max(channel[row, column], value)
