"""Tool orientations in the robot frame: z along the trajectory, x at the free angle from a stated direction.

At free angle 0, tool x points horizontally and as nearly as possible radially away from the z axis of the
robot's base, so the arm reaches over the patient with the mount turned outwards from either side. The free
angle turns about tool z, right-handed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ronna_hw.frames import Frame, FrameMismatch, Transform, rigid_of

Array = NDArray[np.float64]

# For a trajectory this close to the radial direction, "radially away" is undefined; robot z replaces it.
PARALLEL_SINE = math.sin(math.radians(5.0))
ON_AXIS_MM = 1.0  # this close to the base's z axis, no radial direction exists
UP = np.array([0.0, 0.0, 1.0])
AHEAD = np.array([1.0, 0.0, 0.0])


def reference_direction(axis: Array, at_mm: Array) -> Array:
    """Unit tool x (3,) at free angle 0 for a tool axis (3,) and a tool origin (3,) mm in the robot frame.

    The horizontal radial direction at the origin, made perpendicular to the axis. Within 5 degrees of the
    axis, robot z replaces it; on the base's z axis, robot x does.
    """
    radial = np.array([at_mm[0], at_mm[1], 0.0])
    radius_mm = float(np.linalg.norm(radial))
    wanted = radial / radius_mm if radius_mm > ON_AXIS_MM else AHEAD
    across = wanted - axis * float(axis @ wanted)
    if np.linalg.norm(across) < PARALLEL_SINE:
        across = UP - axis * float(axis @ UP)
    return np.asarray(across / np.linalg.norm(across))


def tool_orientation(axis: Array, at_mm: Array, free_angle_rad: float) -> Rotation:
    """Rotation robot <- tool for a unit tool axis (3,) and a tool origin (3,) mm, both in the robot frame."""
    x_zero = reference_direction(axis, at_mm)
    y_zero = np.cross(axis, x_zero)
    x = math.cos(free_angle_rad) * x_zero + math.sin(free_angle_rad) * y_zero
    return Rotation.from_matrix(np.column_stack([x, np.cross(axis, x), axis]))


def turned_onto(orientation: Rotation, axis: Array) -> Rotation:
    """The orientation robot <- tool turned by the smallest rotation that aligns tool z with a unit axis (3,).

    For a refined registration: follows the small change of the axis without any turn about it.
    """
    tool_z = np.asarray(orientation.as_matrix(), dtype=float)[:, 2]
    turn_axis = np.cross(tool_z, axis)
    sine, cosine = float(np.linalg.norm(turn_axis)), float(tool_z @ axis)
    if sine == 0.0:
        return orientation
    return Rotation.from_rotvec(turn_axis / sine * math.atan2(sine, cosine)) * orientation


def tool_pose(orientation: Rotation, origin_mm: Array) -> Transform:
    """The pose ROBOT <- TOOL with this orientation at an origin (3,) mm in the robot frame."""
    return Transform(Frame.ROBOT, Frame.TOOL, rigid_of(origin_mm, orientation))


def back_along_axis(pose: Transform, distance_mm: float) -> Transform:
    """The pose moved against its own tool z, away from the patient."""
    require_frames(pose, Frame.ROBOT, Frame.TOOL)
    return Transform(
        Frame.ROBOT,
        Frame.TOOL,
        rigid_of(pose.apply([0.0, 0.0, -distance_mm]), pose.rigid.rotation),
    )


def require_frames(transform: Transform, target: Frame, source: Frame) -> None:
    """Raises FRM-001 unless the transform is target <- source."""
    if (transform.target, transform.source) != (target, source):
        raise FrameMismatch(
            f"a transform {target} <- {source} is needed", got=f"{transform.target} <- {transform.source}"
        )
