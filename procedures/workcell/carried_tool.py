"""The mounted tool on the arm as it is: nominal, or by the calibration record where the theatre has one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from procedures.workcell.errors import AnotherArm
from ronna_hw.arm.catalogue import kinematics_named
from ronna_hw.arm.deviations import ArmDeviations, CalibratedArm
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.calibration import ArmCalibration
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Transform

# From which side each joint comes, +1 or -1: what is known of its backlash then counts. None: not known.
Sides = Sequence[int] | None


def calibrated_arm(kinematics: Kinematics, record: ArmCalibration | None) -> CalibratedArm:
    """The arm with its deviations; the nominal one without a record.

    Raises CAL-013 for another arm's record, ARM-009 for an arm that calibrations could not find by its name.
    """
    kinematics_named(kinematics.name)
    if record is None:
        return CalibratedArm(kinematics)
    if record.arm != kinematics.name or len(record.sag_rad) != len(kinematics.axis_names):
        raise AnotherArm(
            f"calibration {record.identifier} belongs to another arm",
            expected=kinematics.name,
            got=record.arm,
        )
    return CalibratedArm(kinematics, ArmDeviations.of(record))


def require_this_arm(record: ArmCalibration | None, serial: str) -> None:
    """Raise CAL-013 for the record of another arm of the model; `serial` is empty where none is reported."""
    if record is not None and record.serial and serial and record.serial != serial:
        raise AnotherArm(
            f"calibration {record.identifier} belongs to another arm", expected=serial, got=record.serial
        )


@dataclass(frozen=True)
class CarriedTool:
    """A tool on an arm: between poses ROBOT <- TOOL and joint angles."""

    arm: CalibratedArm
    flange_from_tool: Transform

    def pose(self, joints_rad: JointVector, arrived: Sides = None) -> Transform:
        """Where the tool is at joint angles; `arrived` says from which side each joint came, where known."""
        return self.arm.flange_pose(joints_rad, arrived) @ self.flange_from_tool

    def joints_at(self, pose: Transform, near: JointVector, arriving: Sides = None) -> JointVector:
        """Joints that bring the tool to a pose, in the branch of `near`. Raises ARM-001 to ARM-003."""
        return self.arm.compensated(pose @ self.flange_from_tool.inverse(), near, arriving).joints_rad

    def commanded(
        self, pose: Transform, here_rad: Callable[[], JointVector], arriving: Sides = None
    ) -> Transform:
        """What the controller, which knows no calibration, must be told to bring the tool to a pose.

        `here_rad` measures the joints, in whose branch the arm stays.
        """
        if self.arm.is_nominal:
            return pose
        flange = self.arm.compensated(pose @ self.flange_from_tool.inverse(), here_rad(), arriving).commanded
        return flange.to_transform() @ self.flange_from_tool
