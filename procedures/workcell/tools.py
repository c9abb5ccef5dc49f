"""The mounted tool, according to the last reading of the controller's inputs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from procedures.workcell.errors import AnotherArm, WrongTool
from ronna_hw.arm.calibrated import CalibratedArm
from ronna_hw.arm.catalogue import kinematics_named
from ronna_hw.arm.deviations import ArmDeviations
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.calibration import STEREO_HEAD_NUMBER, ArmCalibration
from ronna_hw.config import Calibrations
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform


class MountedTool(StrEnum):
    """The mounted tool, as far as it has been checked."""

    UNKNOWN = "unchecked tool"
    STEREO_HEAD = "stereo head"
    GUIDE = "guide"


class ToolMount:
    """The mount of one arm. `tool` is what was found there last."""

    def __init__(self, read_number: Callable[[], int], calibrations: Calibrations) -> None:
        self.tool = MountedTool.UNKNOWN
        self._reported: int | None = None  # when the inputs were last read
        self._read_number = read_number
        self._calibrations = calibrations

    @property
    def checked_number(self) -> int | None:
        """The number of the tool that was found last; None while that is not known."""
        return None if self.tool is MountedTool.UNKNOWN else self._number(self.tool)

    def check(self, tool: MountedTool) -> int:
        """The tool's number; raises PRO-009 when another is mounted."""
        expected = self._number(tool)
        self.tool = MountedTool.UNKNOWN
        mounted = self._reported = self._read_number()
        if mounted != expected:
            raise WrongTool(
                f"the {tool} is not mounted",
                expected=f"{tool}, number {expected}",
                got=f"number {mounted} from the controller's inputs",
            )
        self.tool = tool
        return mounted

    def identify(self) -> MountedTool:
        """Whichever tool is mounted; unchecked when it is none of ours or cannot be read."""
        self.tool = MountedTool.UNKNOWN
        with contextlib.suppress(RonnaError):
            mounted = self._reported = self._read_number()
            known = (MountedTool.STEREO_HEAD, MountedTool.GUIDE)
            self.tool = next((tool for tool in known if self._number(tool) == mounted), MountedTool.UNKNOWN)
        return self.tool

    def flange_from(self, tool: MountedTool) -> Transform:
        """FLANGE <- TOOL of a tool, from its calibration record. Raises PRO-009 for an unchecked one."""
        if tool is MountedTool.UNKNOWN:
            known = (f"{each}, number {self._number(each)}" for each in list(MountedTool)[1:])
            raise WrongTool(
                "the mounted tool is not a calibrated one, or has not been checked",
                expected=" or ".join(known),
                got="nothing read yet"
                if self._reported is None
                else f"number {self._reported} when the controller's inputs were last read",
            )
        records = self._calibrations
        record = records.tool_tip if tool is MountedTool.GUIDE else records.stereo_head
        return record.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)

    def _number(self, tool: MountedTool) -> int:
        guide = tool is not MountedTool.STEREO_HEAD
        return self._calibrations.tool_tip.tool_number if guide else STEREO_HEAD_NUMBER


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
