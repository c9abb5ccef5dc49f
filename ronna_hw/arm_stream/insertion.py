"""Plan of an insertion: a straight line along the instrument's axis, and nothing else."""

from __future__ import annotations

from math import atan2, degrees, hypot, isfinite, radians

from ronna_hw.arm.errors import InsertionInvalid
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.devices.contact import INSERTION_SPEED_MM_S, Insertion
from ronna_hw.devices.robot import LineMove
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

OFF_AXIS_MM = 0.2  # proposed requirement DA-5: what a guide takes without bending the instrument
OFF_AXIS_RAD = radians(0.2)


def plan_insertion(
    kinematics: Kinematics, start_rad: JointVector, insertion: Insertion, limits: MotionLimits
) -> LineMove:
    """Return the line of an insertion; raises ARM-012, and FRM-001 for other frames."""
    speed, force_limit = insertion.speed_mm_s, insertion.force_limit_N
    if not 0.0 < speed <= INSERTION_SPEED_MM_S:
        raise InsertionInvalid(
            "the speed of an insertion", limit=f"{INSERTION_SPEED_MM_S:g} mm/s", got=f"{speed:g} mm/s"
        )
    if force_limit is not None and not (isfinite(force_limit) and force_limit > 0.0):
        raise InsertionInvalid(
            "the force limit of an insertion", expected="above 0 N", got=f"{force_limit:g} N"
        )
    tool = kinematics.flange_pose(start_rad) @ insertion.flange_from_tool
    way = tool.inverse() @ insertion.target
    x, y, _ = way.translation_mm.tolist()
    aside, turn = hypot(x, y), rotation_angle_rad(way)
    if not (aside <= OFF_AXIS_MM and turn <= OFF_AXIS_RAD):
        raise InsertionInvalid(
            "the target is not on the instrument's axis",
            limit=f"{OFF_AXIS_MM:g} mm and {degrees(OFF_AXIS_RAD):g} deg",
            got=f"{aside:.3f} mm and {degrees(turn):.3f} deg",
        )
    fraction = min(speed / limits.line_speed_mm_s, 1.0)
    return LineMove(insertion.target, insertion.flange_from_tool, fraction)


def travel_along_axis_mm(
    kinematics: Kinematics, before_rad: JointVector, after_rad: JointVector, insertion: Insertion
) -> float:
    """Return how far the instrument has moved along its axis."""
    before = kinematics.flange_pose(before_rad) @ insertion.flange_from_tool
    after = kinematics.flange_pose(after_rad) @ insertion.flange_from_tool
    return float((before.inverse() @ after).translation_mm[2])


def rotation_angle_rad(transform: Transform) -> float:
    """Return the angle of a rotation; small ones keep their digits."""
    w, x, y, z = transform.quaternion_wxyz.tolist()
    return 2.0 * atan2(hypot(x, y, z), abs(w))
