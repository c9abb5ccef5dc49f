"""Plan of an insertion: a straight line along the instrument's axis, and nothing else."""

from __future__ import annotations

from itertools import pairwise
from math import atan2, degrees, hypot, isfinite, radians

from ronna_hw.arm.errors import INSERTION_INVALID
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm_stream.drill_feed import DrillWatch
from ronna_hw.devices.contact import BORE_SPEED_MM_S, INSERTION_SPEED_MM_S, Insertion
from ronna_hw.devices.robot import LineMove
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector, vector3

# Safety against an instrument that leaves its axis. Source: proposed requirement DA-5.
OFF_AXIS_MM = 0.2  # proposed requirement DA-5: what a guide takes without bending the instrument
OFF_AXIS_RAD = radians(0.2)

BEGUN_MM = 1.0  # past the start of its line: more than an arm rests beside a set-point
LEAST_DRILLED_MM = 0.1  # shorter ways of a drill count as that
# Safety against a drill pressed until its limit trips (U).
HOLD_SHARE = 0.8  # of the way from the force that slows it to the limit: there the feed rests
# Of a target from the z axis at the start of its line: twice what the errors of an uncalibrated KR 6 change
# along an axis of 170 mm, by simulated arms; those of a UR5e change a fifth of that.
BENT_MM, BENT_RAD = 2.5, radians(1.0)


def plan_insertion(
    kinematics: Kinematics, start_rad: JointVector, insertion: Insertion, limits: MotionLimits
) -> LineMove:
    """Return the line of an insertion; raises ARM-012, and FRM-001 for other frames."""
    speed, force_limit = insertion.speed_mm_s, insertion.force_limit_N
    fastest = BORE_SPEED_MM_S if insertion.in_bore else INSERTION_SPEED_MM_S
    if not 0.0 < speed <= fastest:
        raise INSERTION_INVALID("the speed of an insertion", limit=f"{fastest:g} mm/s", got=f"{speed:g} mm/s")
    if force_limit is not None and not (isfinite(force_limit) and force_limit > 0.0):
        raise INSERTION_INVALID(
            "the force limit of an insertion", expected="above 0 N", got=f"{force_limit:g} N"
        )
    tool = kinematics.flange_pose(start_rad) @ insertion.flange_from_tool
    limit, start = (OFF_AXIS_MM, OFF_AXIS_RAD), tool
    if insertion.start is not None:
        beside = _beside_line(tool, insertion)
        _require_within(beside, limit, "the instrument is not on the line to the target")
        limit, start = (BENT_MM, BENT_RAD), insertion.start
    way = start.inverse() @ insertion.target
    x, y, _ = way.translation_mm.tolist()
    aside = hypot(x, y), rotation_angle_rad(way)
    _require_within(aside, limit, "the target is not on the instrument's axis")
    fraction = min(speed / limits.line_speed_mm_s, 1.0)
    return LineMove(insertion.target, insertion.flange_from_tool, fraction)


def _beside_line(tool: Transform, insertion: Insertion) -> tuple[float, float]:
    """Return how far (mm, rad) a tool is beside the line that leads from the start to the target."""
    assert insertion.start is not None
    whole, rest = (insertion.target.inverse() @ one for one in (insertion.start, tool))
    length_mm, rest_mm = whole.translation_mm[2], rest.translation_mm[2]
    share = rest_mm / length_mm if length_mm else 1.0
    aside_mm = rest.translation_mm - share * whole.translation_mm
    turned_rad = rest.rigid.rotation.as_rotvec() - share * whole.rigid.rotation.as_rotvec()
    return hypot(*aside_mm.tolist()), hypot(*turned_rad.tolist())


def _require_within(found: tuple[float, float], limit: tuple[float, float], what: str) -> None:
    """Raise ARM-012 for a distance in mm or an angle in rad above its limit, or not finite."""
    if not (found[0] <= limit[0] and found[1] <= limit[1]):
        raise INSERTION_INVALID(
            what,
            limit=f"{limit[0]:g} mm and {degrees(limit[1]):g} deg",
            got=f"{found[0]:.3f} mm and {degrees(found[1]):.3f} deg",
        )


def has_begun(kinematics: Kinematics, here_rad: JointVector, insertion: Insertion) -> bool:
    """Whether the tool is past the start of its line, as when an insertion goes on after a stop."""
    if insertion.start is None:
        return False
    tool = kinematics.flange_pose(here_rad) @ insertion.flange_from_tool
    return float((insertion.start.inverse() @ tool).translation_mm[2]) > BEGUN_MM


def drill_watch(kinematics: Kinematics, start_rad: JointVector, insertion: Insertion) -> DrillWatch | None:
    """Return how the real-time process feeds a drill on the rest of its way, None for another instrument.

    Raises ARM-012 for a drill without a force limit, or limits out of order.
    """
    drill, limit_N = insertion.drill, insertion.force_limit_N
    if drill is None:
        return None
    forces_N = (0.0, drill.free_N, drill.touch_N, drill.slow_N, limit_N or 0.0)
    if any(low >= high for low, high in pairwise(forces_N)) or not 0.0 < drill.fall_share < 1.0:
        raise INSERTION_INVALID(
            "the forces by which a drill is fed",
            expected="0 < free < touch < slow < limit, and a fall to a share below 1",
            got=", ".join(f"{force:g}" for force in forces_N[1:]) + f" N, {drill.fall_share:g}",
        )
    if not 0.0 < drill.side_N <= forces_N[-1]:
        raise INSERTION_INVALID(
            "the force across a drill",
            expected=f"above 0, at most the limit of {forces_N[-1]:g} N",
            got=f"{drill.side_N:g} N",
        )
    if not 0.0 <= drill.friction <= 1.0:
        raise INSERTION_INVALID(
            "the friction of a drill", expected="0 to 1 of the force across it", got=f"{drill.friction:g}"
        )
    tool = kinematics.flange_pose(start_rad) @ insertion.flange_from_tool
    rest_mm = max(float((tool.inverse() @ insertion.target).translation_mm[2]), LEAST_DRILLED_MM)
    return DrillWatch(
        slow_N=drill.slow_N,
        hold_N=drill.slow_N + HOLD_SHARE * (forces_N[-1] - drill.slow_N),
        touch_N=drill.touch_N,
        free_N=drill.free_N,
        fall_share=drill.fall_share,
        earliest=1.0 - drill.earliest_mm / rest_mm,
        free=drill.free_mm / rest_mm,
        bone_from=1.0 - drill.bone_from_mm / rest_mm,
        bone_by=1.0 - drill.bone_by_mm / rest_mm,
        side_N=drill.side_N,
        friction=drill.friction,
        axis=vector3(insertion.target.rotation_matrix[:, 2]),
    )


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
