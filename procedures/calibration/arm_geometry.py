"""What the errors of an arm's geometry do to the place of a ball, look by look, and how large they may be.

An uncalibrated arm errs by tenths of a millimetre, and not at random: each link is a little longer, shorter
or twisted in all looks alike. Left out, such errors pass for a tool centre elsewhere. Every kind of error is
one column here, and the adjustment finds its size together with the head.

What the last link does is the same as a tool centre elsewhere: no look tells the two apart. Its size per
axis is the limit of any calibration by a ball with an uncalibrated arm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.arm.model import ArmModel, JointVector

Array = NDArray[np.float64]

# One standard deviation each, of an uncalibrated arm of this class: set S of the error study that reproduces
# the published accuracies.
LINK_TRANSLATION_MM = 0.40
LINK_ROTATION_RAD = float(np.radians(0.05))
JOINT_OFFSET_RAD = float(np.radians(0.05))
HARMONIC_RAD = (float(np.radians(0.015)), float(np.radians(0.008)))  # once, twice per turn of the joint
# Error per axis and look from which on an arm counts as uncalibrated: the luckiest of thirty drawn shows it.
# One that shows less has a better geometry, in proportion; what the last link does shows nowhere.
UNCALIBRATED_MM = 0.10
X, Y, Z = np.eye(3)
# Axis of each joint in the frame of the link before it; a positive A1, A4, A6 turns against the right hand.
AXES = (-Z, Y, Y, -X, Y, -X)


def error_columns(model: ArmModel, joints_rad: Sequence[JointVector], ball_mm: Array) -> Array:
    """Movement (n, 3, k) of a point at `ball_mm` (robot frame) that hangs on the flange, mm.

    One column per error of one standard deviation: six of every link at its far end, offset and harmonics
    of every joint. Chain: Rz(-A1) Tx Ry(A2) Tx Ry(A3) Tz Rx(-A4) Tx Ry(A5) Tx Rx(-A6).
    """
    angles = np.asarray(joints_rad, dtype=float)
    ends = np.array(
        [
            (model.shoulder_offset_mm, 0.0, 0.0),
            (model.upper_arm_mm, 0.0, 0.0),
            (0.0, 0.0, model.elbow_offset_mm),
            (model.forearm_mm, 0.0, 0.0),
            (model.flange_mm, 0.0, 0.0),
            (0.0, 0.0, 0.0),
        ]
    )
    place = np.tile([0.0, 0.0, model.base_height_mm], (len(angles), 1))
    turned = np.tile(np.eye(3), (len(angles), 1, 1))  # robot <- link
    columns: list[Array] = []
    for joint, (axis, end) in enumerate(zip(AXES, ends, strict=True)):
        swing = np.cross(turned @ axis, ball_mm - place)  # of the ball, per radian of this joint
        columns.append(JOINT_OFFSET_RAD * swing)
        for order, size_rad in enumerate(HARMONIC_RAD, start=1):
            phase = order * angles[:, joint, None]
            columns += [size_rad * np.sin(phase) * swing, size_rad * np.cos(phase) * swing]
        turned = turned @ Rotation.from_rotvec(angles[:, joint, None] * axis).as_matrix()
        place = place + turned @ end
        for direction in (X, Y, Z):
            columns.append(LINK_TRANSLATION_MM * (turned @ direction))
            columns.append(LINK_ROTATION_RAD * np.cross(turned @ direction, ball_mm - place))
    return np.stack(columns, axis=2)
