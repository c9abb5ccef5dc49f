"""Preview of a motion before execution: planned, slowed near the head, and summarised for users and records.

Where the arm must slow down, near the head and in some operating modes, the path parameter gets a few steps
of speed. The generator follows them; the monitor does not know them and measures independently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isinf

import numpy as np

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.sweep import ARC_FACTOR, SweptPath, motion_mm, sweep_path
from ronna_hw.arm.kinematics import Kinematics, SingularMeasure
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.progress import MOST_STEPS, AxisState, SpeedStep, drive_states
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.devices.robot import JointMove, Motion
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform
from ronna_hw.vectors import JointVector

SHARE_OF_CAP = 0.97  # share of a cap used by planning; the rest covers its sampling
ALIKE = 0.95  # neighbouring speeds within this ratio are merged into one step


def plan_motion(
    kinematics: Kinematics, start_rad: JointVector, motion: Motion, limits: MotionLimits
) -> MotionPlan:
    """Plan a motion from `start_rad`, scaling the limits by its speed fraction.

    Frames are checked once; then the plan is plain floats. Raises FRM-001 for a line between other frames, or
    to anything but a transform, ARM-006 for an invalid fraction, and the errors of `plan_joint_move` and
    `plan_line`.
    """
    slowed = limits.slowed(motion.speed_fraction)
    if isinstance(motion, JointMove):
        return plan_joint_move(kinematics, start_rad, motion.target_rad, slowed)
    tool = motion.flange_from_tool
    for value in (motion.target, *(() if tool is None else (tool,))):
        _require_transform(value)
    if tool is None:
        return plan_line(kinematics, start_rad, Pose.from_transform(motion.target), slowed)
    flange = Pose.from_transform(motion.target @ _tool_in_flange(tool).inverse())
    x, y, z = tool.translation_mm.tolist()
    return plan_line(kinematics, start_rad, flange, slowed, (x, y, z))


def _require_transform(value: object) -> None:
    """Raise FRM-001 for anything but a transform, such as the pose vector of a controller."""
    if not isinstance(value, Transform):
        raise FRAME_MISMATCH(
            "a line needs transforms, which say between which frames they are",
            expected="a Transform robot <- flange, or with a tool robot <- tool",
            got=type(value).__name__,
            action="Build it by Transform.of(Frame.ROBOT, Frame.FLANGE, translation_mm=..., "
            "quaternion_wxyz=...). A pose vector has other units (m, rotation vector in rad): convert it.",
        )


def _tool_in_flange(flange_from_tool: Transform) -> Transform:
    """Return a tool transform unchanged; raises FRM-001 if it is not FLANGE <- TOOL."""
    if (flange_from_tool.target, flange_from_tool.source) != (Frame.FLANGE, Frame.TOOL):
        raise FRAME_MISMATCH(
            "a tool needs flange <- tool", got=f"{flange_from_tool.target} <- {flange_from_tool.source}"
        )
    return flange_from_tool


def preview_motion(
    kinematics: Kinematics,
    start_rad: JointVector,
    motion: Motion,
    surroundings: Surroundings,
    limits: MotionLimits,
) -> PathPreview:
    """Plan and preview a motion from `start_rad` within the arm's limits; raises like `plan_motion`."""
    plan = plan_motion(kinematics, start_rad, motion, limits)
    return preview(kinematics, plan, surroundings, limits.slowed(motion.speed_fraction))


def preview(
    kinematics: Kinematics, plan: MotionPlan, surroundings: Surroundings, limits: MotionLimits
) -> PathPreview:
    """Evaluate a planned path as the arm would execute it in these surroundings.

    Raises ARM-001 to ARM-003 if the path has no solution; one that is not clear is reported, not raised.
    """
    path = sweep_path(kinematics, plan, surroundings)
    slowed = with_speed_steps(plan, path, limits.body_speed_mm_s)
    states = [] if plan.is_standstill else drive_states(slowed.limits, slowed.speed_steps, limits.cycle_s)
    speeds = _interval_speeds(path, states)
    joints = path.joints_rad
    rates = np.abs(np.diff(joints, axis=0)) / np.diff(path.fractions)[:, None]
    shares = (rates * speeds[:, None]) / np.array(limits.speed_rad_s)
    moved_mm = motion_mm(path.swept).max(axis=1, initial=0.0) / ARC_FACTOR  # expected, not an upper bound
    body = moved_mm / np.diff(path.fractions) * speeds
    nearest = float(path.swept.to_head_mm.min())
    measures = [kinematics.singular_measure(tuple(row)) for row in joints.tolist()]
    return PathPreview(
        duration_s=len(states) * limits.cycle_s,
        joint_ranges_rad=tuple(
            (float(low), float(high)) for low, high in zip(joints.min(0), joints.max(0), strict=True)
        ),
        closest=path.closest,
        refused=path.refused,
        singularity=SingularMeasure(*(min(kind) for kind in zip(*measures, strict=True))),
        largest_joint_speed_share=float(shares.max()),
        largest_speed_mm_s=float(body.max()),
        nearest_to_head_mm=None if isinf(nearest) else nearest,
    )


def _interval_speeds(path: SweptPath, states: Sequence[AxisState]) -> Array:
    """Return the peak path-parameter speed per interval as executed; short paths stay below the limit."""
    positions = np.array([0.0, *(state.position[0] for state in states)])
    velocities = np.array([0.0, *(state.velocity[0] for state in states)])
    at_ends = np.interp(path.fractions, positions, velocities)
    speeds: Array = np.maximum(at_ends[:-1], at_ends[1:])
    intervals = np.searchsorted(path.fractions, positions, side="right") - 1
    np.maximum.at(speeds, np.clip(intervals, 0, len(speeds) - 1), velocities)
    return speeds


def with_speed_steps(plan: MotionPlan, path: SweptPath, body_speed_mm_s: float) -> MotionPlan:
    """Add speed steps to a plan so that no moving body exceeds its speed cap.

    `body_speed_mm_s` is the limit of the operating mode, everywhere.
    """
    allowed = np.minimum(allowed_speed(path, body_speed_mm_s), plan.limits.velocity)
    places = np.linspace(0.0, 1.0, MOST_STEPS + 1)
    begins, ends = path.fractions[:-1], path.fractions[1:]
    steps: list[SpeedStep] = []
    for low, high in zip(places[:-1].tolist(), places[1:].tolist(), strict=True):
        velocity = float(allowed[(ends > low) & (begins < high)].min())
        if steps and ALIKE < velocity / steps[-1].velocity < 1.0 / ALIKE:
            steps[-1] = SpeedStep(steps[-1].start, min(velocity, steps[-1].velocity))
        else:
            steps.append(SpeedStep(low, velocity))
    needed = any(step.velocity < plan.limits.velocity for step in steps)
    return replace(plan, speed_steps=tuple(steps) if needed else ())


def allowed_speed(path: SweptPath, body_speed_mm_s: float) -> Array:
    """Return the maximum path-parameter speed in each interval of a swept path, (n - 1), per s."""
    moved = motion_mm(path.swept).max(axis=1)
    rates = moved / np.diff(path.fractions)
    # Within an interval the rate may exceed its average; the neighbours show by how much.
    padded = np.concatenate([rates[:1], rates, rates[-1:]])
    rates = np.maximum(np.maximum(padded[:-2], padded[1:-1]), padded[2:])
    to_head = path.swept.to_head_mm
    with np.errstate(invalid="ignore"):
        nearest = np.where(np.isinf(to_head[:-1]), np.inf, (to_head[:-1] + to_head[1:] - moved) / 2.0)
    nearest = np.maximum(np.minimum(nearest, np.minimum(to_head[:-1], to_head[1:])), 0.0)
    caps = np.array([path.bodies.surroundings.cap_mm_s(distance) for distance in nearest.tolist()])
    caps = np.minimum(caps, body_speed_mm_s)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(rates > 0.0, SHARE_OF_CAP * caps / rates, np.inf))
