"""Positioning of the tool's tip: by the arm alone, and iterated on the tracker's feedback.

Knows measurements only: what the tracker sees, where the arm's axes are, and what was calibrated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from procedures.calibration.hand_eye import HandEye
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.robot import JointMove
from ronna_hw.devices.sensors import OpticalTracker
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector
from studies.errors import PHANTOM_OUT_OF_REACH
from studies.low_cost.arms import PositionedArm
from studies.low_cost.devices import StudiedSight, require_look

SETTLED_MM, SETTLED_RAD = 0.1, math.radians(0.1)
MOST_ROUNDS = 5


@dataclass(frozen=True)
class TipModel:
    """An arm and its tool as the procedure knows them: kinematics, and FLANGE <- TOOL."""

    kinematics: Kinematics
    flange_from_tip: Transform

    def joints(self, robot_from_tip: Transform) -> JointVector:
        """Return the joints that bring the tip to a pose, near home. Raises STU-010."""
        home = self.kinematics.home_rad
        pose = Pose.from_transform(robot_from_tip @ self.flange_from_tip.inverse())
        try:
            return self.kinematics.solve_branch(pose, self.kinematics.branch_of(home), home)
        except LimitError as error:
            raise PHANTOM_OUT_OF_REACH(f"the arm does not reach a pose of the tool: {error}") from error


@dataclass(frozen=True)
class BelievedPositioning(TipModel):
    """An arm calibrated with the tracker: also ROBOT <- TRACKER."""

    robot_from_tracker: Transform

    @classmethod
    def of(
        cls, kinematics: Kinematics, calibrated: HandEye, tip_from_marker: Transform
    ) -> BelievedPositioning:
        """Build from a calibration with these kinematics, and the tip TOOL <- MARKER."""
        marker = Transform.from_matrix(Frame.FLANGE, Frame.MARKER, calibrated.flange_from_marker)
        tracker = Transform.from_matrix(Frame.ROBOT, Frame.TRACKER, calibrated.robot_from_tracker)
        return cls(kinematics, marker @ tip_from_marker.inverse(), tracker)


@dataclass(frozen=True)
class Residual:
    """Distance and angle of the tip from its target, as the tracker sees them."""

    distance_mm: float
    angle_rad: float

    @property
    def is_settled(self) -> bool:
        return self.distance_mm < SETTLED_MM and self.angle_rad < SETTLED_RAD


@dataclass(frozen=True)
class Positioned:
    """Result of the iteration: corrections made, and the last residual seen."""

    rounds: int
    residual: Residual


class TipPositioner:
    """Positions the tip at poses in the frame of the phantom."""

    def __init__(
        self,
        arm: PositionedArm,
        tracker: OpticalTracker,
        tip_from_marker: Transform,
        frames: int,
    ) -> None:
        self._arm = arm
        self._tracker = tracker
        self._marker_from_tip = tip_from_marker.inverse()
        self._frames = frames

    def aim(self, model: BelievedPositioning, phantom: Transform, target: Transform) -> Transform:
        """Move to a target PATIENT <- TOOL once, by the calibration alone (method 1).

        `phantom` is the pose TRACKER <- PATIENT. Returns the pose ROBOT <- TOOL that was commanded.
        """
        commanded = model.robot_from_tracker @ phantom @ target
        self._arm.move(JointMove(model.joints(commanded)))
        return commanded

    def iterate(self, model: BelievedPositioning, commanded: Transform, target: Transform) -> Positioned:
        """Correct by what the tracker sees, until settled or too many rounds (method 2)."""
        for rounds in range(MOST_ROUNDS + 1):
            seen = require_look(self._tracker, self._frames)
            residual = self.residual(seen, target)
            if residual.is_settled or rounds == MOST_ROUNDS:
                break
            commanded = self._corrected(model, commanded, seen, target)
            self._arm.move(JointMove(model.joints(commanded)))
        return Positioned(rounds, residual)

    def residual(self, seen: StudiedSight, target: Transform) -> Residual:
        """Return how far the tip is from its target in one look."""
        tip = seen.patient_from_marker @ self._marker_from_tip
        angle = (target.rigid.rotation.inv() * tip.rigid.rotation).magnitude()
        return Residual(float(np.linalg.norm(tip.translation_mm - target.translation_mm)), float(angle))

    def _corrected(
        self, model: BelievedPositioning, commanded: Transform, seen: StudiedSight, target: Transform
    ) -> Transform:
        """Return the command moved by the residual, along the robot's axes."""
        wanted = model.robot_from_tracker @ seen.phantom @ target
        tip = model.robot_from_tracker @ seen.tool @ self._marker_from_tip
        turned = wanted.rigid.rotation * tip.rigid.rotation.inv() * commanded.rigid.rotation
        moved = commanded.translation_mm + wanted.translation_mm - tip.translation_mm
        return Transform(Frame.ROBOT, Frame.TOOL, RigidTransform.from_components(moved, turned))
