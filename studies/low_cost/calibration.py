"""Calibration of base and tracker, and of flange and tool frame, from looks about the targets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.calibration.frame_calibration import Use, assign_uses
from procedures.calibration.hand_eye import HandEye, PosePairs, misses_of, solve
from procedures.calibration.pose_set import order_by_orientation, plan_poses_about, rms_mm
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arrays import Array
from ronna_hw.devices.robot import JointMove
from ronna_hw.devices.sensors import OpticalTracker
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector
from studies.low_cost.arms import PositionedArm
from studies.low_cost.devices import look
from studies.low_cost.positioning import TipModel
from studies.low_cost.targets import REFERENCE

FITTED, HELD_OUT = 32, 8
# Of arms with nominal parameters, over all of the workspace, per axis.
LARGEST_SCATTER_MM, LARGEST_SCATTER_RAD = 3.0, math.radians(1.0)
TILT_RAD, TURN_RAD = math.radians(25.0), math.radians(35.0)  # with more, the tool's frame turns out of sight


@dataclass(frozen=True)
class CalibrationLooks:
    """What arm and tracker showed: measured joints, and poses TRACKER <- MARKER (m, 4, 4)."""

    joints_rad: tuple[JointVector, ...]
    tracker_from_marker: Array

    def pairs(self, kinematics: Kinematics, use: Use) -> PosePairs:
        """Return the pairs for one use, with the flange as these kinematics compute it."""
        uses = assign_uses(len(self.joints_rad) - HELD_OUT, HELD_OUT)
        rows = [number for number, one in enumerate(uses) if one is use]
        flange = [kinematics.flange_pose(self.joints_rad[row]).as_matrix() for row in rows]
        return PosePairs(np.array(flange), self.tracker_from_marker[rows])


@dataclass(frozen=True)
class FrameCalibration:
    """Both frames by one model of the arm, with the rms of the looks held out."""

    fit: HandEye
    held_out_mm: float
    held_out_rad: float


def take_looks(
    arm: PositionedArm, tracker: OpticalTracker, model: TipModel, points_mm: Sequence[ArrayLike], frames: int
) -> CalibrationLooks:
    """Look at the tool's frame in orientations about points (3,) of the robot frame."""
    planned = [
        plan_poses_about(
            REFERENCE, points_mm[number % len(points_mm)], 1, number, tilt_rad=TILT_RAD, turn_rad=TURN_RAD
        )[0]
        for number in range(FITTED + HELD_OUT)
    ]
    joints, seen = [], []
    for one in order_by_orientation(planned):
        reading = arm.move(JointMove(model.joints(one.pose)))
        if (found := look(tracker, frames)) is not None:
            joints.append(reading.joints_rad)
            seen.append(found.tool.as_matrix())
    return CalibrationLooks(tuple(joints), np.array(seen))


def calibrate(looks: CalibrationLooks, kinematics: Kinematics) -> FrameCalibration:
    """Solve for both frames, and judge them by the looks held out. Raises CAL-002 to CAL-004, CAL-015."""
    fit = solve(
        looks.pairs(kinematics, Use.FIT),
        largest_scatter_mm=LARGEST_SCATTER_MM,
        largest_scatter_rad=LARGEST_SCATTER_RAD,
    )
    misses = misses_of(
        looks.pairs(kinematics, Use.VALIDATION), fit.flange_from_marker, fit.robot_from_tracker
    )
    return FrameCalibration(fit, rms_mm(misses[:, :3]), rms_mm(misses[:, 3:]))


@dataclass(frozen=True)
class PivotFit:
    """Tip of a tool pivoted about a fixed point: `tip_mm` (3,) in its frame, rms of the point."""

    tip_mm: Array
    rms_mm: float


def fit_pivot(poses: Sequence[Transform]) -> PivotFit:
    """Fit tip t and pivot c to poses of the tool's frame: R t + p = c."""
    rotations = np.array([pose.rotation_matrix for pose in poses])
    places = np.array([pose.translation_mm for pose in poses])
    design = np.concatenate([rotations, np.tile(-np.eye(3), (len(poses), 1, 1))], axis=2).reshape(-1, 6)
    solution = np.linalg.lstsq(design, -places.ravel(), rcond=None)[0]
    return PivotFit(solution[:3], rms_mm((design @ solution + places.ravel()).reshape(-1, 3)))
