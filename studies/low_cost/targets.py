"""Targets in the phantom, each approached in three orientations of the tool.

Robot frame at the reference orientation: the tool points down, its x axis forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform

REFERENCE = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])  # robot <- tool
TILT_RAD = math.radians(15.0)
# Tilt azimuth and turn about the tool's axis of each orientation: the tracker keeps seeing the tool's frame.
ORIENTATIONS_RAD = tuple(
    (math.radians(azimuth), math.radians(turn))
    for azimuth, turn in ((0.0, 0.0), (120.0, 20.0), (240.0, -20.0))
)
INNER_SHARE = 0.6  # of the head's half axes: bounds the targets
KEY = 2015  # of the random numbers


@dataclass(frozen=True)
class StudiedTarget:
    """Pose CT <- TOOL that the tool should take: its set is the number of its orientation."""

    number: int
    orientation: int
    ct_from_tool: Transform


def draw_targets(
    seed: int, count: int, centre_ct_mm: Array, semi_axes_mm: Array, ct_from_robot: Rotation
) -> tuple[StudiedTarget, ...]:
    """Draw `count` points in the middle of the phantom, each with every orientation.

    `ct_from_robot`: roughly how the phantom lies, as a planner knows it.
    """
    random = np.random.default_rng([seed, KEY])
    points: list[Array] = []
    while len(points) < count:
        point = random.uniform(-1.0, 1.0, 3)
        if np.linalg.norm(point) < 1.0:
            points.append(centre_ct_mm + INNER_SHARE * point * semi_axes_mm)
    return tuple(
        StudiedTarget(number, orientation, _pose(point, ct_from_robot * oriented(orientation)))
        for orientation in range(len(ORIENTATIONS_RAD))
        for number, point in enumerate(points)
    )


def oriented(number: int) -> Rotation:
    """Return an orientation ROBOT <- TOOL by its number."""
    azimuth, turn = ORIENTATIONS_RAD[number]
    tilt = Rotation.from_rotvec(TILT_RAD * np.array([math.cos(azimuth), math.sin(azimuth), 0.0]))
    return REFERENCE * tilt * Rotation.from_rotvec([0.0, 0.0, turn])


def _pose(point_mm: Array, rotation: Rotation) -> Transform:
    return Transform(Frame.CT, Frame.TOOL, RigidTransform.from_components(point_mm, rotation))
