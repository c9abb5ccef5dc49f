"""The tool on an arm, its calibrated poses, and the instrument in the guide."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from enum import StrEnum

from procedures.calibration.validity import MADE_BY_HAND
from procedures.journal.journal import Entry
from procedures.workcell.arm_history import ArmLog, Opening, Stop
from procedures.workcell.errors import INSTRUMENT_IN_GUIDE, SAME_ARM_TWICE, AnotherArm, WrongTool
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibrated_arm.deviations import ArmDeviations
from ronna_hw.calibration import STEREO_HEAD_NUMBER, ArmCalibration
from ronna_hw.config import Calibrations
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import ASSISTANT, MASTER


class MountedTool(StrEnum):
    """Mounted tool, as found by the last check."""

    UNKNOWN = "unchecked tool"
    STEREO_HEAD = "stereo head"
    GUIDE = "guide"


class ToolMount:
    """Tool mount of one arm. `tool` is the tool found by the last check."""

    def __init__(self, read_number: Callable[[], int], calibrations: Calibrations) -> None:
        self.tool = MountedTool.UNKNOWN
        self._reported: int | None = None  # when the inputs were last read
        self._read_number = read_number
        self._calibrations = calibrations

    @property
    def checked_number(self) -> int | None:
        """Number of the tool found by the last check; None if unknown."""
        return None if self.tool is MountedTool.UNKNOWN else self._number(self.tool)

    def check(self, tool: MountedTool) -> int:
        """Check that a tool is mounted and return its number. Raises PRO-009 for another tool."""
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
        """Identify the mounted tool. Return UNKNOWN unless it is a calibrated one."""
        self.tool = MountedTool.UNKNOWN
        with contextlib.suppress(RonnaError):
            mounted = self._reported = self._read_number()
            known = (MountedTool.STEREO_HEAD, MountedTool.GUIDE)
            self.tool = next((tool for tool in known if self._number(tool) == mounted), MountedTool.UNKNOWN)
        return self.tool

    def flange_from(self, tool: MountedTool) -> Transform:
        """Return FLANGE <- TOOL from a tool's calibration record. Raises PRO-009 for an unknown tool."""
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


def calibrated_arm(
    kinematics: Kinematics, records: Mapping[str, ArmCalibration], role: str = MASTER
) -> CalibratedArm:
    """Return the arm in a role with its record's deviations applied, or the nominal arm without a record.

    Raises CAL-013 for another arm's record, ARM-009 for an arm whose name is not in the catalogue.
    """
    find_arm(kinematics.name)
    if (record := records.get(role)) is None:
        return CalibratedArm(kinematics)
    if record.arm != kinematics.name or len(record.sag_rad) != len(kinematics.axis_names):
        exchanged = any(other.arm == kinematics.name for other in records.values() if other is not record)
        raise _another_arm(record, kinematics.name, record.arm, role, exchanged=exchanged, model=True)
    return CalibratedArm(kinematics, ArmDeviations.of(record))


def require_this_arm(records: Mapping[str, ArmCalibration], serial: str, role: str = MASTER) -> None:
    """Raise CAL-013 if the record for a role is of another arm of this model. '' is an unreported serial."""
    record = records.get(role)
    if record is not None and record.serial and serial and record.serial != serial:
        exchanged = any(other.serial == serial for other in records.values() if other is not record)
        raise _another_arm(record, serial, record.serial, role, exchanged=exchanged)


def _another_arm(
    record: ArmCalibration, expected: str, got: str, role: str, *, exchanged: bool, model: bool = False
) -> AnotherArm:
    """Return the refusal of a record, with advice that leaves the record of the other role as it is."""
    what, action = f"calibration {record.identifier} belongs to another arm than the {role}", None
    if exchanged:
        what += ", and the record of the other role to this one: the two records are swapped"
        action = (
            "Exchange [calibration.arm] and [calibration.assistant_arm], or else the endpoints of "
            "[robot.master] and [robot.assistant]."
        )
    elif role == ASSISTANT:
        action = (
            "Name this arm's own record in [calibration.assistant_arm]; if it has none, "
            f"{MADE_BY_HAND['assistant_arm']}."
        )
    if model and not exchanged:
        otherwise = action or AnotherArm.action
        action = f"If the arm is a {got}, say so in [robot.{role}.options]. Otherwise: {otherwise}"
    return AnotherArm(what, expected=expected, got=got, action=action)


def require_two_arms(master: tuple[str, str], assistant: tuple[str, str]) -> None:
    """Raise DUAL-004 if two arms have the same model and serial number. An empty one is unreported."""
    model, serial = master
    if serial and master == assistant:
        raise SAME_ARM_TWICE("master and assistant are one arm", got=f"{model} {serial}, twice")


class WorkedStages:
    """Stages of work through the guide at each trajectory, preserved across motions, failures and restarts.

    A stage is journalled as begun before anybody works, and as done once that is confirmed.
    """

    def __init__(self, log: ArmLog) -> None:
        self._log = log

    def tasks_at(self, trajectory: str) -> Mapping[str, bool]:
        """Return the tasks begun at a trajectory, and whether each was confirmed as done."""
        return self._log.history.stages.get(trajectory, {})

    def is_doubted(self, trajectory: str) -> bool:
        """Return whether more may have been done at a trajectory than the journal records."""
        return trajectory in self._log.history.doubted

    def may_have_begun(self, trajectory: str) -> bool:
        """Return whether work at a trajectory has, or may have, begun."""
        return bool(self.tasks_at(trajectory)) or self.is_doubted(trajectory)

    def interruption_at(self, trajectory: str) -> str | None:
        """Return what interrupted a stage at a trajectory, unless one was done since."""
        return self._log.history.interruptions.get(trajectory)

    def stop_at(self, trajectory: str) -> Stop | None:
        """Return the last depth stop setting at a trajectory, if any."""
        return self._log.history.stops.get(trajectory)

    def record_stop(self, trajectory: str, stop: Stop) -> None:
        """Record that the depth stop was set, read and confirmed."""
        self._log.write(Entry.STAGE, trajectory=trajectory, stop=stop)

    def opening_at(self, trajectory: str) -> Opening | None:
        """Return the last opening that an assistant drilled at a trajectory, if any."""
        return self._log.history.openings.get(trajectory)

    def record_opening(self, trajectory: str, opening: Opening) -> None:
        """Record an opening of the skull, before anything else goes through it."""
        self._log.write(Entry.STAGE, trajectory=trajectory, opening=opening)

    def record_doubt(self, trajectory: str) -> None:
        """Record that more may have been done than the journal says, since its last lines may be lost."""
        if not self.is_doubted(trajectory):
            self._log.write(Entry.STAGE, trajectory=trajectory, doubted=True)

    def record_begin(self, trajectory: str, task: str) -> None:
        """Record that a stage is about to begin."""
        self._log.write(Entry.STAGE, trajectory=trajectory, task=task, done=False)

    def record_interruption(self, trajectory: str, task: str, reason: str) -> None:
        """Record what has interrupted a stage, for later questions about it."""
        self._log.note(Entry.STAGE, trajectory=trajectory, task=task, interrupted=reason)

    def record_done(self, trajectory: str, task: str) -> None:
        """Record that a stage was confirmed as done."""
        self._log.write(Entry.STAGE, trajectory=trajectory, task=task, done=True)


class Instrument:
    """Instrument in the guide. Nothing may move while it is, or may be, in an entry or the gauge.

    An insertion is journalled before it begins, a removal once it is confirmed.
    """

    def __init__(self, log: ArmLog) -> None:
        self._log = log
        self.stages = WorkedStages(log)

    @property
    def inside(self) -> str | None:
        """Trajectory, gauge or divot that the instrument is or may be in; None if it is out."""
        return self._log.history.place.instrument_may_be_inside

    def record_insertion(self, trajectory: str) -> None:
        """Record that the instrument is about to be inserted."""
        self._log.write(Entry.INSTRUMENT, trajectory=trajectory, inside=True)

    def record_removal(self) -> None:
        """Record that the instrument was confirmed to be out."""
        if self.inside is not None:
            self._log.write(Entry.INSTRUMENT, trajectory=self.inside, inside=False)

    def record_assumed(self, trajectory: str) -> None:
        """Record that the instrument may be inside, although no earlier line says so."""
        self._log.write(Entry.INSTRUMENT, trajectory=trajectory, inside=True, assumed=True)

    def require_out(self, what: str) -> None:
        """Raise TOOL-001 while the instrument is inside. `what` is the refused action."""
        if self.inside is not None:
            raise INSTRUMENT_IN_GUIDE(
                f"{what}: an instrument is in the guide, and in {self.inside}",
                expected="the instrument removed, and confirmed to be out",
            )
