"""How an arm's geometric errors displace a ball in each view, and how large they may be.

An uncalibrated arm is off by tenths of a millimetre, and not at random: each link is slightly too long, too
short or twisted, the same in all views. If ignored, such errors are mistaken for an offset of the tool
centre. Each kind of error is one column here; the adjustment estimates its size together with the head.

Errors of the last link are equivalent to an offset of the tool centre: no view can separate the two. Their
size per axis limits any calibration with a ball and an uncalibrated arm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.arm.kinematics import Chain

Array = NDArray[np.float64]

# One standard deviation each for an uncalibrated arm of this class: parameter set S of the error study, which
# reproduces the published accuracies.
LINK_TRANSLATION_MM = 0.40
LINK_ROTATION_RAD = float(np.radians(0.05))
JOINT_OFFSET_RAD = float(np.radians(0.05))
HARMONIC_RAD = (float(np.radians(0.015)), float(np.radians(0.008)))  # once and twice per turn of the joint
# An arm with a larger error per axis and view counts as uncalibrated; the best of thirty random arms
# reaches this value. For a smaller error the geometry is assumed proportionally better; the last
# link's part never shows.
UNCALIBRATED_MM = 0.10
X, Y, Z = np.eye(3)


def error_columns(chain: Chain, joints_rad: ArrayLike, ball_mm: Array) -> Array:
    """Displacement (n, 3, k), mm, of a point at `ball_mm` (robot frame) fixed to the flange.

    One column per error, at one standard deviation: six for every link at its far end, offset and harmonics
    for every joint. `joints_rad` is (n, axes).
    """
    angles = np.asarray(joints_rad, dtype=float)
    place = np.tile(chain.base_mm, (len(angles), 1))
    turned = np.tile(np.eye(3), (len(angles), 1, 1))  # robot <- link
    columns: list[Array] = []
    for joint, (axis_of_joint, to_next_mm) in enumerate(chain.joints):
        axis = np.array(axis_of_joint)
        swing = np.cross(turned @ axis, ball_mm - place)  # of the ball, per radian of this joint
        columns.append(JOINT_OFFSET_RAD * swing)
        for order, size_rad in enumerate(HARMONIC_RAD, start=1):
            phase = order * angles[:, joint, None]
            columns += [size_rad * np.sin(phase) * swing, size_rad * np.cos(phase) * swing]
        turned = turned @ Rotation.from_rotvec(angles[:, joint, None] * axis).as_matrix()
        place = place + turned @ np.array(to_next_mm)
        for direction in (X, Y, Z):
            columns.append(LINK_TRANSLATION_MM * (turned @ direction))
            columns.append(LINK_ROTATION_RAD * np.cross(turned @ direction, ball_mm - place))
    return np.stack(columns, axis=2)
