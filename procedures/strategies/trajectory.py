"""Planned straight path into the head, and the tool's poses along it.

Five numbers of a trajectory are set by the surgeon, one angle is free. The tool's z axis is along the
trajectory. At free angle 0, tool x points horizontally and as nearly as possible radially away from the z
axis of the robot's base. So the arm reaches over the patient with the mount turned outwards from either side.
The free angle turns about tool z, right-handed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.strategies.errors import BAD_TRAJECTORY
from ronna_hw.arguments import require_numbers
from ronna_hw.arrays import Array
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform, build_rigid

Point = tuple[float, float, float]

SHORTEST_MM = 1e-3  # below a micrometre the direction is rounding noise

# For a trajectory this close to the radial direction, "radially away" is undefined; robot z replaces it.
PARALLEL_SINE = math.sin(math.radians(5.0))
ON_AXIS_MM = 1.0  # this close to the base's z axis, no radial direction exists
LARGEST_ANGLE_RAD = 4.0 * math.pi  # a plan's half turn, and turns tried about it, stay far within
UP = np.array([0.0, 0.0, 1.0])
AHEAD = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Trajectory:
    """Entry and target in CT coordinates (LPS, mm) and the free angle about the axis (rad).

    `beyond_mm` is how far beyond the target, along the axis, the tool origin comes to rest: a guide is held
    outside the head, and its tip frame is at the end of its mandrel. `standoff_mm` is the plan's, from the
    entry to the guide, for messages. Raises STR-003 when entry and target coincide, or a number is
    not finite, has another shape, or is an angle of more than two turns.
    """

    identifier: str
    entry_mm: Point
    target_mm: Point
    free_angle_rad: float = 0.0
    beyond_mm: float = 0.0
    standoff_mm: float | None = None

    def __post_init__(self) -> None:
        """Raise STR-003 unless all numbers are finite, in range, and entry and target are distinct."""
        numbers = np.concatenate(
            [
                self._require_numbers("entry_mm", (3,)),
                self._require_numbers("target_mm", (3,)),
                *(self._require_numbers(name, ()).reshape(1) for name in ("free_angle_rad", "beyond_mm")),
            ]
        )
        if not np.isfinite(numbers).all():
            raise BAD_TRAJECTORY(f"trajectory {self.identifier} has a number that is not finite")
        if abs(self.free_angle_rad) > LARGEST_ANGLE_RAD:
            raise BAD_TRAJECTORY(
                f"the free angle of trajectory {self.identifier} is more than two turns: are these degrees?",
                limit=f"{LARGEST_ANGLE_RAD:.3f} rad",
                got=f"{self.free_angle_rad:g} rad",
                action="Give radians, such as math.radians(30).",
            )
        if self.depth_mm < SHORTEST_MM:
            raise BAD_TRAJECTORY(f"entry and target of trajectory {self.identifier} coincide")

    def _require_numbers(self, name: str, shape: tuple[int, ...]) -> Array:
        what = f"the numbers in {name} of trajectory {self.identifier}"
        return require_numbers(getattr(self, name), what, shape=shape, mistake=BAD_TRAJECTORY)

    def with_rest(self, beyond_mm: float, standoff_mm: float | None = None) -> Trajectory:
        """Return a copy of the trajectory whose tool comes to rest `beyond_mm` past the target."""
        return replace(self, beyond_mm=beyond_mm, standoff_mm=standoff_mm)

    @property
    def rest_mm(self) -> Array:
        """Rest position (3,) of the tool origin in CT coordinates, mm."""
        return np.asarray(np.add(self.target_mm, self.beyond_mm * self.axis_ct))

    @property
    def depth_mm(self) -> float:
        """Distance from entry to target, mm."""
        return math.dist(self.entry_mm, self.target_mm)

    @property
    def axis_ct(self) -> Array:
        """Unit vector (3,) from entry to target, into the head, in CT coordinates."""
        return np.subtract(self.target_mm, self.entry_mm) / self.depth_mm


def split_along(offset_mm: Array, axis: Array) -> tuple[float, float]:
    """Split an offset (3,) into its length across a unit axis (3,), and its part along it, in mm."""
    along_mm = float(offset_mm @ axis)
    return float(np.linalg.norm(offset_mm - along_mm * axis)), along_mm


def reference_direction(axis: Array, at_mm: Array) -> Array:
    """Return unit tool x (3,) at free angle 0 for a tool axis (3,) and origin (3,) mm in the robot frame.

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
    """Return the rotation robot <- tool for a unit tool axis (3,) and an origin (3,) mm, robot frame."""
    x_zero = reference_direction(axis, at_mm)
    y_zero = np.cross(axis, x_zero)
    x = math.cos(free_angle_rad) * x_zero + math.sin(free_angle_rad) * y_zero
    return Rotation.from_matrix(np.column_stack([x, np.cross(axis, x), axis]))


def turn_onto(orientation: Rotation, axis: Array) -> Rotation:
    """Turn the orientation robot <- tool by the smallest rotation that aligns tool z with a unit axis (3,).

    For a refined registration: follows the small change of the axis without any turn about it.
    """
    tool_z = np.asarray(orientation.as_matrix(), dtype=float)[:, 2]
    turn_axis = np.cross(tool_z, axis)
    sine, cosine = float(np.linalg.norm(turn_axis)), float(tool_z @ axis)
    if sine == 0.0:
        return orientation
    return Rotation.from_rotvec(turn_axis / sine * math.atan2(sine, cosine)) * orientation


def tool_pose(orientation: Rotation, origin_mm: Array) -> Transform:
    """Return the pose ROBOT <- TOOL with this orientation at an origin (3,) mm in the robot frame."""
    return Transform(Frame.ROBOT, Frame.TOOL, build_rigid(origin_mm, orientation))


def back_along_axis(pose: Transform, distance_mm: float) -> Transform:
    """Return the pose moved back along its own tool z axis, away from the patient."""
    require_frames(pose, pose.target, Frame.TOOL)
    back_mm = pose.apply([0.0, 0.0, -distance_mm])
    return Transform(pose.target, Frame.TOOL, build_rigid(back_mm, pose.rigid.rotation))


def require_frames(transform: Transform, target: Frame, source: Frame) -> None:
    """Raise FRM-001 unless the transform is target <- source."""
    if (transform.target, transform.source) != (target, source):
        raise FRAME_MISMATCH(
            f"a transform {target} <- {source} is needed", got=f"{transform.target} <- {transform.source}"
        )


def target_pose(trajectory: Trajectory, robot_from_ct: Transform) -> Transform:
    """Return the pose ROBOT <- TOOL at the target. Raises FRM-001 unless the transform is ROBOT <- CT."""
    return tool_pose(orientation_along(trajectory, robot_from_ct), robot_from_ct.apply(trajectory.rest_mm))


def refine_target_pose(planned: Transform, trajectory: Trajectory, robot_from_ct: Transform) -> Transform:
    """Return the target pose for a refined transform, given the pose `planned` with the coarse one.

    The smallest rotation turns the orientation onto the finer axis, so that no turn about the axis creeps in
    between localization and target. Raises FRM-001 on other frames.
    """
    require_frames(robot_from_ct, Frame.ROBOT, Frame.CT)
    require_frames(planned, Frame.ROBOT, Frame.TOOL)
    orientation = turn_onto(planned.rigid.rotation, _axis(trajectory, robot_from_ct))
    return tool_pose(orientation, robot_from_ct.apply(trajectory.rest_mm))


def poses_along(
    trajectory: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform
) -> tuple[Transform, ...]:
    """Return one pose ROBOT <- TOOL per fiducial (n, 3) in CT mm, all in a trajectory's orientation."""
    orientation = orientation_along(trajectory, robot_from_ct)
    points = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    return tuple(tool_pose(orientation, robot_from_ct.apply(point)) for point in points)


def orientation_along(trajectory: Trajectory, robot_from_ct: Transform) -> Rotation:
    """Return the rotation robot <- tool at a trajectory's target. Raises FRM-001 for other frames."""
    require_frames(robot_from_ct, Frame.ROBOT, Frame.CT)
    target = robot_from_ct.apply(trajectory.target_mm)
    return tool_orientation(_axis(trajectory, robot_from_ct), target, trajectory.free_angle_rad)


def _axis(trajectory: Trajectory, robot_from_ct: Transform) -> Array:
    return np.asarray(robot_from_ct.rotation_matrix @ trajectory.axis_ct)
