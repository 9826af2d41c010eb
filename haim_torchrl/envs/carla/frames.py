"""CARLA's frame and the two frames of this package.

CARLA is left-handed: x forward, y to the right, z up, yaw in degrees, clockwise as seen from
above. :mod:`haim_torchrl.envs.path` has the same axes with headings in rad, so that numbers go
over as they are. Recordings (:mod:`haim_torchrl.evaluation.recording`) have y to the left and
headings counter-clockwise: y and the heading change their sign.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from haim_torchrl.envs.carla.package import carla_package
from haim_torchrl.envs.path import Array

Pose = tuple[float, float, float]
"""x [m], y [m] to the right, heading [rad] clockwise."""


def pose_of(transform: Any) -> Pose:
    """The pose of a ``carla.Transform``, with a heading in (-π, π]."""
    location = transform.location
    return location.x, location.y, wrapped(math.radians(transform.rotation.yaw))


def centre_of(transform: Any, box: Any) -> Pose:
    """The pose of a ``carla.BoundingBox``'s middle; the origin of an actor lies elsewhere.

    Not by ``transform.transform(box.location)``, which changes the location that it is given.
    """
    x, y, heading = pose_of(transform)
    ahead, right = box.location.x, box.location.y
    cos, sin = math.cos(heading), math.sin(heading)
    return x + cos * ahead - sin * right, y + sin * ahead + cos * right, heading


def origin_of(pose: Pose, box: Any, z: float) -> Any:
    """The ``carla.Transform`` that puts a bounding box's middle at a pose, standing at height z."""
    x, y, heading = pose
    ahead, right = box.location.x, box.location.y
    cos, sin = math.cos(heading), math.sin(heading)
    return transform_of((x - cos * ahead + sin * right, y - sin * ahead - cos * right, heading), z)


def transform_of(pose: Pose, z: float = 0.0) -> Any:
    """The ``carla.Transform`` of a pose at a height [m]."""
    carla = carla_package()
    x, y, heading = pose
    location = carla.Location(x=float(x), y=float(y), z=float(z))
    return carla.Transform(location, carla.Rotation(yaw=math.degrees(heading)))


def wrapped(angle: float) -> float:
    """The angle [rad] in (-π, π]."""
    return math.pi - (math.pi - angle) % (2 * math.pi)


def to_recording(boxes: Array) -> Array:
    """Boxes (x, y, heading, length, width), [M, 5], or one, [5], in the frame of recordings."""
    return boxes * [1.0, -1.0, -1.0, 1.0, 1.0]


def points_to_recording(points: Array) -> Array:
    """Points, [P, 2], in the frame of recordings."""
    return points * np.array([1.0, -1.0])
