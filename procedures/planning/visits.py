"""Poses visited by the arm during a procedure, and the results of checking them.

Each pose is approached and left along the tool axis, from a point outside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.errors import NotReachable
from procedures.planning.pose_name import PoseKind, PoseName
from procedures.planning.scene import PlanningScene
from procedures.strategies.skin_looks import SKIN, skin_axis
from procedures.strategies.strategy import ArmInBranch, Strategy
from procedures.strategies.trajectory import Trajectory, back_along_axis, require_frames, target_pose
from ronna_hw.arm.kinematics import Branch, Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED, ErrorSizes
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

if TYPE_CHECKING:
    from procedures.planning.tracker_sight import TrackerSight

APPROACH_MM = 60.0  # before the fiducial, or before the guide's held position


@dataclass(frozen=True)
class Visit:
    """Pose ROBOT <- TOOL to be visited, with an approach point back along the tool axis.

    `approach_mm` is the distance of the approach point from the pose; the retreat is the same line reversed.
    """

    name: PoseName
    pose: Transform
    approach_mm: float

    @property
    def approach(self) -> Transform:
        """Approach pose ROBOT <- TOOL."""
        return back_along_axis(self.pose, self.approach_mm)


@dataclass(frozen=True)
class Reached:
    """A visit with the joint angles at its approach point, and the line to its pose."""

    visit: Visit
    approach_rad: JointVector
    line: MotionPlan

    @property
    def at_rad(self) -> JointVector:
        """Joint angles at the pose."""
        return self.line.target_rad

    @property
    def standing_at(self) -> tuple[PoseName, JointVector]:
        """Name of the pose, and the joint angles there."""
        return self.visit.name, self.at_rad


@dataclass(frozen=True)
class Unmet:
    """A pose that fails, and the reason: for records and commands, and in a surgeon's `words`.

    `short_mm` is how much clearance a motion to the pose lacks; None if that is not what fails.
    """

    pose: PoseName
    reason: str
    words: str
    short_mm: float | None = None

    @classmethod
    def from_error(cls, pose: PoseName, error: LimitError) -> Self:
        """Build the failure from an error raised by the arm's kinematics or planner."""
        return cls(pose, f"{error.summary} [{error.code}]", error.summary)


@dataclass(frozen=True)
class PathCheck:
    """Result of a path check: all visits with joints in one branch, or the failures in the best branch.

    `largest_turn_rad` is the largest turn of any axis between two approach points, or from the start.
    """

    branch: Branch | None
    reached: tuple[Reached, ...]
    unmet: tuple[Unmet, ...]
    largest_turn_rad: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the whole procedure can be executed in this branch."""
        return not self.unmet

    @property
    def joint_ranges_rad(self) -> tuple[tuple[float, float], ...]:
        """Minimum and maximum angle of each axis over all poses; empty if no pose is reached."""
        angles = [joints for one in self.reached for joints in (one.approach_rad, one.at_rad)]
        return tuple((min(axis), max(axis)) for axis in zip(*angles, strict=True))

    @property
    def targets(self) -> tuple[Reached, ...]:
        """Visits of the targets."""
        return tuple(one for one in self.reached if one.visit.name.kind is PoseKind.TARGET)

    def at(self, name: PoseName) -> Reached:
        """Return the visit of this pose; raises KeyError."""
        for one in self.reached:
            if one.visit.name == name:
                return one
        raise KeyError(str(name))

    def require(self, advice: str | None = None) -> None:
        """Raise PLAN-007 with all failures, if any. `advice` replaces the usual action."""
        if self.unmet:
            lines = "; ".join(f"{one.pose}: {one.reason}" for one in self.unmet)
            raise NotReachable(f"{len(self.unmet)} pose(s) cannot be reached: {lines}", action=advice)


@dataclass(frozen=True)
class ArmSetting:
    """Arm setting for path checks: assumed CT pose, mounted tools, start.

    `robot_from_ct` is the coarse transform, `flange_from_tool` the guide, `flange_from_stereo` the stereo
    head's tool centre point (the same by design; None uses the guide's). `limits` are those that the arm
    states for its operating mode. With a `scene`, every motion must also be clear of everything in it.
    `sizes` are those of the arm's remaining errors. `gauge_rad` is where the guide is checked after mounting;
    None leaves that out. With `sights` of a tracker on the head, targets that leave one of them open past the
    guide are preferred. `skin_looks` are given poses ROBOT <- TOOL with the tool centre on the skin, in their
    order, for all targets; the strategy is for the fiducials.
    """

    kinematics: Kinematics
    robot_from_ct: Transform
    flange_from_tool: Transform
    strategy: Strategy
    start_rad: JointVector
    limits: MotionLimits
    flange_from_stereo: Transform | None = None
    approach_mm: float = APPROACH_MM
    scene: PlanningScene | None = None
    sizes: ErrorSizes = UNCALIBRATED
    gauge_rad: JointVector | None = None
    sights: Sequence[TrackerSight] = ()
    skin_looks: Sequence[Transform] = ()

    def __post_init__(self) -> None:
        """Raise FRM-001 if a transform has the wrong frames."""
        require_frames(self.robot_from_ct, Frame.ROBOT, Frame.CT)
        require_frames(self.flange_from_tool, Frame.FLANGE, Frame.TOOL)
        if self.flange_from_stereo is not None:
            require_frames(self.flange_from_stereo, Frame.FLANGE, Frame.TOOL)

    def in_branch(self, branch: Branch) -> ArmInBranch:
        """Return the arm in this branch for use by strategies."""
        return ArmInBranch(
            self.kinematics,
            flange_from_guide=self.flange_from_tool,
            flange_from_stereo=self.flange_from_stereo or self.flange_from_tool,
            branch=branch,
            near_rad=self.start_rad,
            sizes=self.sizes,
        )


@dataclass(frozen=True)
class Axes:
    """Axes of a procedure, for localizing the spheres and for reaching the targets.

    They are the same if the strategy localizes for every trajectory.
    """

    localized: tuple[Trajectory, ...]
    targeted: tuple[Trajectory, ...]

    @classmethod
    def of(cls, setting: ArmSetting, trajectories: Sequence[Trajectory], fiducials_mm: ArrayLike) -> Self:
        """Return the axes chosen by the strategy, at the planned free angles, and one for all skin looks."""
        along = setting.strategy.localized_along(trajectories, fiducials_mm, setting.robot_from_ct)
        if setting.skin_looks:
            along = (*along, skin_axis(setting.skin_looks, setting.robot_from_ct))
        return cls(along, tuple(trajectories))

    @property
    def distinct(self) -> tuple[Trajectory, ...]:
        """All axes without duplicates."""
        return tuple({one.identifier: one for one in (*self.localized, *self.targeted)}.values())

    def only(self, identifier: str) -> Axes:
        """Return only the axes of one trajectory."""
        return Axes(
            tuple(one for one in self.localized if one.identifier == identifier),
            tuple(one for one in self.targeted if one.identifier == identifier),
        )

    def turned(self, turns_rad: Mapping[str, float]) -> Axes:
        """Return the axes, each rotated about itself by the angle for its identifier."""

        def turn(axes: Sequence[Trajectory]) -> tuple[Trajectory, ...]:
            return tuple(
                replace(one, free_angle_rad=one.free_angle_rad + turns_rad[one.identifier]) for one in axes
            )

        return Axes(turn(self.localized), turn(self.targeted))


def list_visits(
    setting: ArmSetting, axes: Axes, fiducials_mm: ArrayLike, branch: Branch
) -> tuple[Visit, ...]:
    """List the poses in procedure order: localizations, then, after the tool change, targets.

    Raises the strategy's errors when it finds no poses in this branch.
    """
    visits: list[Visit] = []
    for axis in axes.localized:
        visits += list_localizations(setting, axis, fiducials_mm, branch)
    return (*visits, *(build_target_visit(setting, trajectory) for trajectory in axes.targeted))


def list_localizations(
    setting: ArmSetting, axis: Trajectory, fiducials_mm: ArrayLike, branch: Branch
) -> tuple[Visit, ...]:
    """List the localization poses of fiducials (n, 3) in CT mm along one axis. Raises like `list_visits`."""
    points = np.asarray(fiducials_mm, dtype=float).reshape(-1, 3)
    arm = setting.in_branch(branch)
    poses: Sequence[Transform] = setting.skin_looks
    if axis.identifier != SKIN:
        poses = setting.strategy.localization_poses(axis, points, setting.robot_from_ct, arm)
    return tuple(
        Visit(PoseName(PoseKind.FIDUCIAL, axis.identifier, index), pose, setting.approach_mm)
        for index, pose in enumerate(poses)
    )


def build_target_visit(setting: ArmSetting, trajectory: Trajectory) -> Visit:
    """Build the visit to a target, with the guide outside the skin."""
    pose = target_pose(trajectory, setting.robot_from_ct)
    return Visit(PoseName(PoseKind.TARGET, trajectory.identifier), pose, setting.approach_mm)
