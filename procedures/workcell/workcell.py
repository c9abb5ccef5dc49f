"""Arm, mounted tool, surroundings, stereo head and tracker as one: how procedures look and move.

It exists only with an open journal, and every motion is an intent and a result in it. While the guide is held
before an entry, nothing but motion along its own axis is possible, whatever asks for it; while an instrument
is in it, nothing moves at all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import Entry, Journal
from procedures.planning.tool_records import ToolRecords
from procedures.strategies.approach import AXIAL_SPEED_FRACTION, ONE_SIDE, before_arriving
from procedures.workcell.arm_history import UNMOVED, ArmHistory
from procedures.workcell.arm_log import ArmLog
from procedures.workcell.arm_place import ArmPlace, Where
from procedures.workcell.arm_view import ArmView, stands_at
from procedures.workcell.carried_tool import CarriedTool, Sides, calibrated_arm
from procedures.workcell.cell_motion import CellMotion, MotionName
from procedures.workcell.device_views import DeviceView, StereoView, TrackerView
from procedures.workcell.errors import InstrumentInside
from procedures.workcell.insertion import Insertion
from procedures.workcell.instrument import Instrument
from procedures.workcell.mounted_tool import MountedTool, ToolMount
from procedures.workcell.sensors import Sensors
from procedures.workcell.starting import start
from procedures.workcell.stereo_look import Look, look
from procedures.workcell.supervised_motion import SupervisedMotion
from procedures.workcell.way_home import WayHome
from ronna_hw.arm.clearance.surroundings import Surroundings
from ronna_hw.config import MASTER, Calibrations
from ronna_hw.devices import JointMove, LineMove, RobotArm, StereoPair
from ronna_hw.devices.errors import WrongKind
from ronna_hw.devices.lifecycle import RUNNING, Device, Lifecycle
from ronna_hw.devices.readings import ArmReading, JointVector, LinkStatistics
from ronna_hw.frames import Transform
from ronna_hw.theatre import Theatre
from ronna_hw.theatre_kind import require_one_kind

D = TypeVar("D")


class Workcell:
    """One arm with what it carries. All poses of the tool are ROBOT <- TOOL of the tool that is mounted."""

    def __init__(
        self,
        theatre: Theatre,
        journal: Journal,
        *,
        calibrations: Calibrations | None = None,
        calibrating: bool = False,
        history: ArmHistory = UNMOVED,
    ) -> None:
        """Opens nothing and moves nothing. `calibrations` take the place of those of the theatre file; while
        `calibrating`, the record of a tool may be of a former tip. A resumed run has a `history` already.

        Raises PRO-003 without an open journal, DEV-007 without a device or calibrations, ARM-009, CFG-004 and
        CAL-013.
        """
        if journal.closed:
            raise JournalNotWritable("the journal is closed: nothing may move without it")
        require_one_kind(theatre.file)
        theatre.require("tracker", "stereo", f"robot.{MASTER}")
        self.calibrations = theatre.calibrations if calibrations is None else calibrations
        self._theatre = theatre
        self._calibrated = calibrated_arm(self._arm.kinematics, self.calibrations.arm)
        self._log = ArmLog(journal, theatre.clock, history)
        self._way_home = WayHome(
            self.joints_rad,
            lambda: self._log.history.trail,
            lambda what, to_rad: self.supervised.carry_out(self._joint_motion(what, *_legs(what, to_rad))),
        )
        self.supervised = SupervisedMotion(
            self._log, lambda: self._arm, self._way_home.is_home, self._require_allowed
        )
        self._mount = ToolMount(self.reported_tool_number, self.calibrations)
        self.tools = ToolRecords.of(theatre.file, calibrating=calibrating)
        self.instrument = Instrument(self._log)
        self.surroundings: Surroundings | None = None  # as the arm was last told
        self.on_look: Callable[[Look], None] = lambda _look: None  # of whoever shows it; quick, never raises
        self.on_stop_failed: Callable[[str], object] = lambda _failure: None  # as above
        self.sensors = Sensors(lambda: self._stereo, self.calibrations.stereo_head)

    @property
    def arm(self) -> ArmView:
        """The arm, for looking."""
        return ArmView(self._arm)

    @property
    def _arm(self) -> RobotArm:
        return self._theatre.arms[MASTER]

    @property
    def _stereo(self) -> StereoPair:
        return self._theatre.stereo

    @property
    def stereo(self) -> StereoView:
        """The stereo head."""
        return self._stereo

    @property
    def tracker(self) -> TrackerView:
        """The tracker."""
        return self._theatre.tracker

    @property
    def devices(self) -> dict[str, DeviceView]:
        """All devices by role, in the order in which they are connected; of other kinds by their tables."""
        return {**self._devices, "arm": self.arm}

    @property
    def _devices(self) -> dict[str, Device]:
        others = {f"device.{name}": self.device(name, Device) for name in self._theatre.file.device}
        return {"tracker": self._theatre.tracker, "arm": self._arm, "stereo": self._stereo, **others}

    def device(self, name: str, interface: Callable[..., D]) -> D:
        """A device of table `[device.NAME]` as `interface`. Raises DEV-007, DEV-008, also for an arm."""
        device = self._theatre.device(name, interface)
        if isinstance(device, RobotArm):
            raise WrongKind(
                f"device.{name} is an arm, which only the workcell moves",
                action="Declare it as [robot.NAME].",
            )
        return device

    # What hangs on the arm

    @property
    def tool(self) -> MountedTool:
        """What was found mounted when it was last checked."""
        return self._mount.tool

    def check_mounted(self, tool: MountedTool) -> int:
        """The tool's number, read from the controller's inputs. Raises PRO-009 when another is mounted."""
        return self._mount.check(tool)

    def identify_mounted(self) -> MountedTool:
        """Whichever tool the controller's inputs report; unchecked when it is none of ours or is not said."""
        return self._mount.identify()

    @property
    def streaming(self) -> bool:
        """Whether the arm's correction stream runs; while it does not, nothing of ours can move the arm."""
        return self._arm.observe().state in RUNNING

    @property
    def checked_tool_number(self) -> int | None:
        """The number of the tool that was found mounted; None while that is not known."""
        return self._mount.checked_number

    def reported_tool_number(self) -> int:
        """The number that the controller's inputs report now; 0 is none."""
        return self._arm.read_tool_identity().number

    def flange_from(self, tool: MountedTool) -> Transform:
        """FLANGE <- TOOL of a tool, from its calibration record. Raises PRO-009 for an unchecked one."""
        return self._mount.flange_from(tool)

    @property
    def flange_from_tool(self) -> Transform:
        """FLANGE <- TOOL of the mounted tool."""
        return self.flange_from(self.tool)

    # Where it is

    def joints_rad(self) -> JointVector:
        """The measured joints."""
        return self._arm.read_state().joints_rad

    def tool_pose(self, joints_rad: JointVector | None = None, arrived: Sides = None) -> Transform:
        """Pose of the mounted tool at joint angles, by default at the measured ones; see `Sides`."""
        return self._carried.pose(joints_rad or self.joints_rad(), arrived)

    def flange_pose(self, joints_rad: JointVector) -> Transform:
        """ROBOT <- FLANGE at joint angles, by the arm's calibration or else nominal."""
        return self._calibrated.flange_pose(joints_rad)

    def joints_at(self, pose: Transform, near: JointVector, arriving: Sides = None) -> JointVector:
        """Joints that bring the tool to a pose, in the branch of `near`. Raises ARM-001 to ARM-003."""
        return self._carried.joints_at(pose, near, arriving)

    @property
    def _carried(self) -> CarriedTool:
        return CarriedTool(self._calibrated, self.flange_from_tool)

    @property
    def home_rad(self) -> JointVector:
        """Where the arm stood when the case was set up; raises PRO-001 before that."""
        return self._way_home.home_rad

    @property
    def settled_home(self) -> bool:
        """Whether the arm stands at home, each joint having arrived from the same side as ever."""
        return self._way_home.settled and self.place.is_home

    def set_home(self) -> JointVector:
        """Take where the arm stands for home: the pose it parks in, and goes by when the way is not clear."""
        home_rad = self._way_home.set_home()
        self._log.note(Entry.PLACED, joints_rad=list(home_rad), at_home=True)
        return home_rad

    def take_up(self, history: ArmHistory, home_rad: JointVector | None = None) -> None:
        """Restore how a run that is resumed left the arm; home stays where it is not given. Moves nothing."""
        if home_rad is not None:
            self._way_home.take_up(home_rad)
        self._log.history = history

    def compare_place(self) -> None:
        """Compare the measured joints with home, and write down if the arm is not where the journal says.

        Somebody may have jogged it. An axis it left by hand is compared before the next motion along it.
        Raises the arm's error where it reports no joints.
        """
        if self._way_home.known_rad is None:
            return
        joints_rad = self.joints_rad()
        at_home = stands_at(joints_rad, self.home_rad)
        if at_home != self.place.is_home or self.place.where is Where.UNKNOWN:
            self._way_home.settled = False
            self._log.note(Entry.PLACED, joints_rad=list(joints_rad), at_home=at_home)

    def found_on_axis(self, axis: Insertion) -> None:
        """The guide was found on an axis on which the journal does not have it: its lines may be lost."""
        joints_rad, plain = list(self.joints_rad()), axis.as_plain()
        self._log.note(
            Entry.PLACED, joints_rad=joints_rad, at_home=False, trajectory=axis.trajectory, axis=plain
        )

    # Moving

    @property
    def history(self) -> ArmHistory:
        """What the arm and the hands at it have done so far, as the journal has it."""
        return self._log.history

    @property
    def place(self) -> ArmPlace:
        """Where the arm is, and whether an instrument may be inside."""
        return self._log.history.place

    def surround(self, surroundings: Surroundings, near_rad: JointVector | None = None) -> None:
        """Say what is carried and what stands around it: checks are exact near these joints, or home."""
        near_rad = near_rad or self._way_home.known_rad or self.arm.kinematics.home_rad
        self.surroundings = self._calibrated.as_controller_sees(surroundings, near_rad)
        self._arm.surround(self.surroundings)

    def start(self, *, cameras: bool = False) -> None:
        """Start the correction stream, and the cameras, where they do not run. Raises PRO-002, TOOL-001."""
        if self._arm.state is Lifecycle.CONFIGURED:  # starting an unverified controller moves every axis
            self.instrument.require_out("start the arm")
        start((self._arm, self._stereo) if cameras else (self._arm,), self.supervised)

    def going(self, joints_rad: JointVector) -> CellMotion:
        """The motion that `go` makes."""
        return self._joint_motion(MotionName.GO, JointMove(joints_rad), by_home=True)

    def settling(self, joints_rad: JointVector, arriving: Sides, *, from_afar: bool = False) -> CellMotion:
        """The motion that `settle` makes."""
        onto = JointMove(joints_rad)
        if arriving is None:
            return self._joint_motion(MotionName.STEP, onto)
        back = JointMove(before_arriving(joints_rad, arriving))
        return self._joint_motion(MotionName.SETTLE, back, onto, by_home=from_afar)

    def returning_home(self) -> CellMotion:
        """All that `return_home` does."""
        home = self._joint_motion(MotionName.HOME, *_legs(MotionName.HOME, self.home_rad))
        back = tuple(JointMove(joints_rad) for joints_rad in self._way_home.back_rad)
        return replace(home, otherwise=back and (*back, *home.legs), detour="back the way the arm came")

    def straight(
        self, pose: Transform, arriving: Sides = None, near_rad: JointVector | None = None
    ) -> CellMotion:
        """The motion that `line_to` makes, in the branch of `near_rad` or else of where the arm is."""
        commanded = self._commanded(pose, arriving, near_rad)
        return self._line_motion(MotionName.LINE, pose, LineMove(commanded @ self.flange_from_tool.inverse()))

    def inserting(self, insertion: Insertion, near_rad: JointVector | None = None) -> CellMotion:
        """The motion that `insert` makes; `near_rad` as for `straight`."""
        commanded = self._commanded(insertion.held, insertion.arriving, near_rad)
        line = LineMove(commanded, self.flange_from_tool, AXIAL_SPEED_FRACTION)
        return self._line_motion(MotionName.INSERT, insertion.held, line, insertion)

    def withdrawing(self, insertion: Insertion) -> CellMotion:
        """The motion that `withdraw` makes."""
        line = LineMove(self._commanded(insertion.start, insertion.arriving), self.flange_from_tool)
        return self._line_motion(MotionName.WITHDRAW, insertion.start, line, insertion)

    def go(self, joints_rad: JointVector) -> ArmReading:
        """A joint move, by way of home where the straight one is not clear; ARM-007 when neither is."""
        return self._way_home.past(self.going(joints_rad), self.supervised.carry_out)

    def go_home(self) -> ArmReading:
        """A joint move to where the case began."""
        return self._way_home.go()

    def return_home(self) -> ArmReading:
        """As `go_home`; where that is not clear, back along the way the arm came since it left home."""
        return self._way_home.go_back()

    def settle(self, joints_rad: JointVector, arriving: Sides, *, from_afar: bool = False) -> ArmReading:
        """Take joint angles, each joint arriving in its direction, +1 or -1: backlash is then the same.

        With None straight from where it stands. From afar by way of home where the direct way is not clear.
        """
        settling = self.settling(joints_rad, arriving, from_afar=from_afar)
        return self._way_home.past(settling, self.supervised.carry_out)

    def line_to(self, pose: Transform, arriving: Sides = None) -> ArmReading:
        """A straight line of the flange that brings the mounted tool to a pose."""
        return self.supervised.carry_out(self.straight(pose, arriving))

    def insert(self, insertion: Insertion) -> ArmReading:
        """From where the approach of a trajectory begins along its axis to where the guide is held.

        Raises PRO-009 unless the guide is mounted, PRO-015 unless it is on the axis.
        """
        self._require_outside(MotionName.INSERT)
        self.check_mounted(MountedTool.GUIDE)
        return self.supervised.carry_out(self.inserting(insertion))

    def hold(self) -> None:
        """Stand still, with the standstill watched by the link: out of it leads only the next motion."""
        if self._arm.state is Lifecycle.ACTIVE:
            self._arm.stop()
            self.supervised.is_held()

    def withdraw(self, trajectory: str) -> ArmReading:
        """Back along the axis to where the approach began.

        Raises PRO-014 when the guide is not on that trajectory, PRO-015 when it is beside its axis, TOOL-001
        while an instrument is in it.
        """
        axis = self.place.axis
        if axis is None or axis.trajectory != trajectory:
            on = self.place.trajectory or "no trajectory"
            raise InstrumentInside(f"the guide is not on {trajectory}", expected=trajectory, got=on)
        return self.supervised.carry_out(self.withdrawing(axis))

    def recover(self, role: str, by: str) -> None:
        """Recover a device from its fault; moves nothing. What hangs on the arm counts as unchecked then."""
        device = self._devices[role]
        device.recover(by)
        if device is self._arm:
            self._way_home.settled = False  # somebody may have jogged it
            self.supervised.begin_anew()
            if not self.place.on_axis:  # what is on an axis is the guide
                self._mount.tool = MountedTool.UNKNOWN

    def look(self) -> Look:
        """Take a pair and measure the sphere in it. Raises STE-012 when no new pair comes whole."""
        seen = look(self._stereo, self.calibrations.stereo_head, self._theatre.clock)
        self.on_look(seen)
        return seen

    def link_statistics(self) -> LinkStatistics:
        """Health of the robot link since the arm was last activated."""
        return self._arm.link_statistics()

    def rest(self) -> None:
        """End the arm's correction stream and the cameras, as a tool change and a parked arm want it."""
        for device in (self._arm, self._stereo):
            if device.state in RUNNING:
                device.deactivate()
        self.supervised.begin_anew()

    def stop(self) -> None:
        """Bring the arm to rest as well as the link still allows; never raises."""
        for failure in self._theatre.stop():
            self.on_stop_failed(failure)
        self.supervised.begin_anew()

    def close(self) -> None:
        """End all connections, the arm's first; never raises."""
        self._theatre.close()

    def _require_allowed(self, motion: CellMotion) -> None:
        """Along its axis while the guide is on it: after a stop someone may have pushed it aside."""
        on, axis = self.place.axis, motion.axis
        if axis is None or (on is not None and axis.trajectory != on.trajectory):
            self._require_outside(motion.what)
        else:
            self.instrument.require_out(motion.what)
            for pose in (self.tool_pose(), axis.held):
                (on or axis).check_on_axis(pose)

    def _joint_motion(self, what: MotionName, *legs: JointMove, by_home: bool = False) -> CellMotion:
        home_rad = self._way_home.known_rad if by_home else None
        otherwise = () if home_rad is None else (*_legs(MotionName.HOME, home_rad), *legs)
        return CellMotion(what, f"the {self.tool}", legs[-1].target_rad, legs, otherwise)

    def _line_motion(
        self, what: MotionName, pose: Transform, line: LineMove, axis: Insertion | None = None
    ) -> CellMotion:
        return CellMotion(what, f"the {self.tool}", tuple(pose.translation_mm.tolist()), (line,), axis=axis)

    def _commanded(self, pose: Transform, arriving: Sides, near_rad: JointVector | None = None) -> Transform:
        return self._carried.commanded(pose, lambda: near_rad or self.joints_rad(), arriving)

    def _require_outside(self, what: str) -> None:
        self.instrument.require_out(what)
        for held in self.place.why_held:
            raise InstrumentInside(f"{what}: {held}", expected=f"a retreat along {self.place.trajectory}")


def _legs(what: MotionName, to_rad: JointVector) -> tuple[JointMove, ...]:
    if what is not MotionName.HOME:
        return (JointMove(to_rad),)
    return (JointMove(before_arriving(to_rad, ONE_SIDE)), JointMove(to_rad))
