"""Interface of localization strategies, the arm they plan for, turns about the axis, and approach joints.

A strategy decides how often fiducials are localized, and in which tool orientations. All strategies hold the
tool the same way at a target, see `target_pose`. Its axis is the trajectory's; only the free angle about it
is chosen.

Backlash shows on the side that a joint comes from. The same arrival direction at fiducials and target makes
it equal at all of them, so the registration removes it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from procedures.strategies.trajectory import Trajectory, back_along_axis, require_frames
from ronna_hw.arm.kinematics import Branch, Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import BACKLASH_RAD, UNCALIBRATED, ErrorSizes
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector, joint_vector

STEP_RAD = math.radians(10.0)
FURTHEST_RAD = math.radians(90.0)

OUTWARDS_RAD: tuple[float, ...] = (
    0.0,
    *(side * step * STEP_RAD for step in range(1, round(FURTHEST_RAD / STEP_RAD) + 1) for side in (1, -1)),
)

# Side from which each joint arrives, +1 or -1: known backlash is then compensated. 0: unknown; None: all.
Sides = Sequence[int] | None
ONE_SIDE = (1, 1, 1, 1, 1, 1)  # which it is does not matter, as long as it is the same
# Safety against a fast approach to the skin (U).
AXIAL_SPEED_FRACTION = 0.5  # of the working speed, on the way towards the skin
# How far each joint stands back before it turns onto a position: ten times the backlash of a worn gear.
APPROACH_RAD = math.radians(0.2)
LAST_STRETCH_MM = 5.0  # of the line to the pose: the direction each joint turns there decides its backlash
WAY_STEPS = 12  # of the line to a pose, for the sides on which joints rest
CORRECTED_MM = 2.0  # by which a pose may yet be corrected: coarse registration of the tracker
# By less, a joint may not have crossed its play; or, on the corrected line, it turns the other way.
SURE_RAD = 2.0 * BACKLASH_RAD


@dataclass(frozen=True)
class ArmInBranch:
    """Arm that a strategy plans for: nominal kinematics, tools as FLANGE <- TOOL, branch, reference joints.

    `sizes` are those of the arm's remaining errors.
    """

    kinematics: Kinematics
    flange_from_guide: Transform
    flange_from_stereo: Transform
    branch: Branch
    near_rad: JointVector
    sizes: ErrorSizes = UNCALIBRATED

    def __post_init__(self) -> None:
        """Raise FRM-001 unless both tools are FLANGE <- TOOL."""
        require_frames(self.flange_from_guide, Frame.FLANGE, Frame.TOOL)
        require_frames(self.flange_from_stereo, Frame.FLANGE, Frame.TOOL)

    def guide_joints(self, pose: Transform) -> JointVector:
        """Return the joints that bring the guide to a pose ROBOT <- TOOL. Raises ARM-001 to ARM-003."""
        return self._joints(pose @ self.flange_from_guide.inverse())

    def stereo_joints(self, pose: Transform) -> JointVector:
        """Return the joints that bring the stereo head to a pose ROBOT <- TOOL. Raises ARM-001 to ARM-003."""
        return self._joints(pose @ self.flange_from_stereo.inverse())

    def _joints(self, flange: Transform) -> JointVector:
        return self.kinematics.solve_branch(Pose.from_transform(flange), self.branch, self.near_rad)

    def stereo_pose(self, joints_rad: JointVector) -> Transform:
        """Return the pose ROBOT <- TOOL of the stereo head at these joints."""
        return self.kinematics.flange_pose(joints_rad) @ self.flange_from_stereo


class Strategy(Protocol):
    """Stateless strategy for tool orientations. Poses are ROBOT <- TOOL, from the coarse transform."""

    @property
    def name(self) -> str:
        """Name on the command line."""
        ...

    @property
    def localizes_per_trajectory(self) -> bool:
        """Whether every trajectory has its own localizations and registration, instead of one shared set."""
        ...

    @property
    def controls_approach(self) -> bool:
        """Whether each joint approaches a fiducial in the same direction as the target. See `arrival_signs`.

        Backlash is then equal at both. Only for strategies that localize per trajectory.
        """
        ...

    @property
    def learns_arm(self) -> bool:
        """Whether the looks are chosen among those of all strategies, and also estimate the arm's errors.

        They then serve all targets, each with a correction of its own.
        """
        return False

    def localized_along(
        self, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike, robot_from_ct: Transform
    ) -> tuple[Trajectory, ...]:
        """Return the axes for localizing all fiducials (n, 3) in CT mm, with one set of poses for each.

        The trajectories themselves, by default, or one axis that is independent of them.
        """
        return tuple(trajectories)

    def localization_poses(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> tuple[Transform, ...]:
        """Return one pose per fiducial (n, 3) in CT mm, with the tool origin at the fiducial.

        Raises FRM-001 on other frames; a strategy that considers joints also raises ARM-001
        to ARM-003, STR-004.
        """
        ...

    def turns_rad(
        self, along: Trajectory, fiducials_mm: ArrayLike, robot_from_ct: Transform, arm: ArmInBranch
    ) -> Sequence[float]:
        """Return turns to add to the trajectory's free angle in rad, best first."""
        ...


def intermediate_turns_rad(turns_rad: Iterable[float]) -> tuple[float, ...]:
    """Return distinct turns a quarter and half a step away from each of `turns_rad`, nearest first.

    A step of 10 degrees moves the hand that carries the default mount by more than 40 mm, several times the
    clearance that a motion needs, so an angle that passes may be between two that do not. Quarter steps are
    about 12 mm at the hand.
    """
    found: dict[int, float] = {}
    for turn in turns_rad:
        for quarters in (1, -1, 2, -2):
            beside = turn + quarters * STEP_RAD / 4.0
            if abs(beside) < FURTHEST_RAD:
                found.setdefault(round(math.degrees(beside) * 1000.0), beside)
    return tuple(found.values())


def arrival_signs(
    kinematics: Kinematics, pose: Transform, at_rad: JointVector, flange_from_tool: Transform
) -> tuple[int, ...]:
    """Return each joint's direction (+1 or -1) on arrival at a pose ROBOT <- TOOL with joints `at_rad`."""
    before = back_along_axis(pose, LAST_STRETCH_MM) @ flange_from_tool.inverse()
    branch = kinematics.branch_of(at_rad)
    joints = kinematics.solve_branch(Pose.from_transform(before), branch, at_rad)
    return tuple(1 if after >= earlier else -1 for earlier, after in zip(joints, at_rad, strict=True))


def rest_sides(
    kinematics: Kinematics, pose: Transform, at_rad: JointVector, flange_from_tool: Transform, way_mm: float
) -> tuple[int, ...]:
    """Return the side of its backlash on which each joint rests after a line of `way_mm` along the axis.

    Arguments and values as in `arrival_signs`, but 0 where the side is not known: the joint hardly turns on
    the line, or it reverses near the pose, which is later corrected.
    """
    tool_from_flange, step_mm = flange_from_tool.inverse(), way_mm / WAY_STEPS
    line = [back_along_axis(pose, step * step_mm) @ tool_from_flange for step in range(WAY_STEPS, 0, -1)]
    branch = kinematics.branch_of(at_rad)
    joints = [kinematics.solve_branch(Pose.from_transform(one), branch, at_rad) for one in line]
    rates = np.diff([*joints, at_rad], axis=0).T / step_mm  # rad/mm, by joint
    return tuple(_rest_side(one, step_mm) for one in rates)


def _rest_side(rates: Array, step_mm: float) -> int:
    """Return the side of one joint, which turns by `rates` (n,) rad/mm on the parts of its line."""
    bend = (rates[-1] - rates[-2]) / step_mm  # rad/mm2
    at_end = rates[-1] + bend * step_mm / 2.0
    signs = np.sign([*rates, at_end - bend * CORRECTED_MM, at_end + bend * CORRECTED_MM])
    if len(set(signs[-3:])) > 1:
        return 0
    turned_back = np.flatnonzero(signs[: len(rates)] != signs[-1])
    since = turned_back[-1] + 1 if len(turned_back) else 0
    return 0 if abs(rates[since:].sum()) * step_mm < SURE_RAD else int(signs[-1])


def approach_joints(joints_rad: JointVector, arriving: Sequence[int]) -> JointVector:
    """Return joints slightly before a position, approached in each joint's direction; 0 leaves a joint."""
    return joint_vector(joint - sign * APPROACH_RAD for joint, sign in zip(joints_rad, arriving, strict=True))
