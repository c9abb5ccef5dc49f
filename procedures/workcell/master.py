"""The arm with the guide: its tool, the surroundings of its motions, and motions along the guide's axis.

While the guide is held before an entry, only motion along its axis is possible, whoever asks. While an
instrument is in the guide, nothing moves at all.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

from procedures.journal.journal import Entry
from procedures.operator.question import Topic
from procedures.strategies.strategy import AXIAL_SPEED_FRACTION, Sides, approach_joints
from procedures.workcell.arm_history import ArmLog, InsertionAxis, MotionKind
from procedures.workcell.arms import Arms
from procedures.workcell.errors import GUIDE_HELD_AT_ENTRY, INSTRUMENT_IN_GUIDE
from procedures.workcell.motions import PlannedMotion
from procedures.workcell.supervised_arm import SupervisedArm
from procedures.workcell.tools import Instrument, MountedTool, ToolMount
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.config import Calibrations
from ronna_hw.devices import JointMove, LineMove
from ronna_hw.devices.readings import ArmReading
from ronna_hw.frames import Transform
from ronna_hw.roles import MASTER
from ronna_hw.vectors import JointVector


class Master(SupervisedArm):
    """The arm that carries the tools; its base is the robot frame. Tool poses are ROBOT <- TOOL."""

    def __init__(
        self, log: ArmLog, arms: Arms, calibrations: Calibrations, others: Iterable[SupervisedArm]
    ) -> None:
        """Supervise the master beside `others`, which may be on the axis of its guide."""
        self._others = tuple(others)
        frame, spoken_name = calibrations.tracker_frame.tool, MASTER if self._others else "arm"
        super().__init__(MASTER, log, arms, calibrations.arms, "arm", frame, spoken_name)
        self.mount = ToolMount(self.read_tool_number, calibrations)
        self.instrument = Instrument(log)
        self.surroundings: Surroundings | None = None  # as last declared to the arm

    @property
    def tool(self) -> MountedTool:
        """Mounted tool, as found by the last check."""
        return self.mount.tool

    def read_tool_number(self) -> int:
        """Return the tool number now reported by the controller's inputs; 0 means no tool."""
        return self._arm.read_tool_identity().number

    def flange_from(self, tool: MountedTool) -> Transform:
        """Return FLANGE <- TOOL from a tool's calibration record. Raises PRO-009 for an unknown tool."""
        return self.mount.flange_from(tool)

    def doubt_tool(self) -> None:
        """Take the tool for unknown after a fault; on an axis, it can only be the guide."""
        if not self.place.is_on_axis:
            self.mount.tool = MountedTool.UNKNOWN

    @property
    def flange_from_tool(self) -> Transform:
        return self.flange_from(self.tool)

    @property
    def carries(self) -> str:
        return f"the {self.tool}"

    def tool_pose(self, joints_rad: JointVector | None = None, arrived: Sides = None) -> Transform:
        """Return the mounted tool's pose at joint angles, by default the measured ones; see `Sides`."""
        return self.flange_pose(joints_rad or self.joints_rad(), arrived) @ self.flange_from_tool

    def joints_at(self, pose: Transform, near: JointVector, arriving: Sides = None) -> JointVector:
        """Return the joints for a tool pose, in the branch of `near`. Raises ARM-001 to ARM-003."""
        return self.calibrated.compensate(pose @ self.flange_from_tool.inverse(), near, arriving).joints_rad

    def surround(self, surroundings: Surroundings, near_rad: JointVector | None = None) -> None:
        """Set the arm's tool and surroundings. Clearance is exact near `near_rad`, by default home."""
        near_rad = near_rad or self._log.home_rad or self.arm.kinematics.home_rad
        self._declare(self.calibrated.as_controller_sees(surroundings, near_rad))

    def shift_room(self, by: Transform, on_cart: Collection[str]) -> None:
        """Move the surroundings against the arm's own moved cart; bodies on this cart, by name, stay."""
        if (around := self.surroundings) is None:
            return
        moved = around.moved(Pose.from_matrix(by.as_matrix().tolist()))
        pairs = zip(around.obstacles, moved.obstacles, strict=True)
        obstacles = tuple(stays if stays.name in on_cart else moves for stays, moves in pairs)
        self._declare(replace(moved, obstacles=obstacles))

    def _declare(self, surroundings: Surroundings) -> None:
        self.surroundings = surroundings
        self._arms.surround(MASTER, surroundings)

    def go_motion(self, joints_rad: JointVector) -> PlannedMotion:
        """Return the motion that `go` would make."""
        return self._via_home(super().go_motion(joints_rad))

    def settle_motion(
        self, joints_rad: JointVector, arriving: Sides, *, allow_detour: bool = False
    ) -> PlannedMotion:
        """Return the motion that `settle` would make."""
        onto = JointMove(joints_rad)
        if arriving is None:
            return self.joint_motion(MotionKind.STEP, onto)
        back = JointMove(approach_joints(joints_rad, arriving), settles=False)
        onto_from_side = self.joint_motion(MotionKind.SETTLE, back, onto)
        return self._via_home(onto_from_side) if allow_detour else onto_from_side

    def line_to_motion(
        self, pose: Transform, arriving: Sides = None, near_rad: JointVector | None = None
    ) -> PlannedMotion:
        """Return the motion that `line_to` would make, in the branch of `near_rad` (default: current)."""
        commanded = self._commanded_pose(pose, arriving, near_rad)
        return self._line_motion(MotionKind.LINE, pose, LineMove(commanded @ self.flange_from_tool.inverse()))

    def insert_motion(self, insertion: InsertionAxis, near_rad: JointVector | None = None) -> PlannedMotion:
        """Return the motion that `insert` would make; `near_rad` as for `line_to_motion`."""
        commanded = self._commanded_pose(insertion.held, insertion.arriving, near_rad)
        line = LineMove(commanded, self.flange_from_tool, AXIAL_SPEED_FRACTION)
        return self._line_motion(MotionKind.INSERT, insertion.held, line, insertion)

    def withdraw_motion(self, insertion: InsertionAxis) -> PlannedMotion:
        """Return the motion that `withdraw` would make."""
        line = LineMove(self._commanded_pose(insertion.start, insertion.arriving), self.flange_from_tool)
        return self._line_motion(MotionKind.WITHDRAW, insertion.start, line, insertion)

    def settle(self, joints_rad: JointVector, arriving: Sides, *, allow_detour: bool = False) -> ArmReading:
        """Move to joint angles, each joint arriving from its given side (+1 or -1) for equal backlash.

        Without directions, go straight there. `allow_detour` allows the way via home if the direct one is not
        clear.
        """
        settle_motion = self.settle_motion(joints_rad, arriving, allow_detour=allow_detour)
        return self.supervised.carry_out_with_detour(settle_motion)

    def line_to(self, pose: Transform, arriving: Sides = None) -> ArmReading:
        """Move the mounted tool to a pose along a straight line of the flange."""
        return self.supervised.carry_out(self.line_to_motion(pose, arriving))

    def insert(self, insertion: InsertionAxis) -> ArmReading:
        """Move the guide along its axis from the start of the approach to its held pose.

        Raises PRO-009 unless the guide is mounted, PRO-015 unless it is on the axis.
        """
        self._require_outside(MotionKind.INSERT)
        self.mount.check(MountedTool.GUIDE)
        return self.supervised.carry_out(self.insert_motion(insertion))

    def withdraw(self, trajectory: str) -> ArmReading:
        """Move the guide back along its axis to the start of the approach.

        Raises PRO-014 if it is not on that trajectory, PRO-015 if it is beside its axis, TOOL-001 while an
        instrument is in it.
        """
        return self.supervised.carry_out(self.withdraw_motion(self._axis_of(trajectory)))

    def lead_out(self, doubt: str = "") -> None:
        """Do nothing: the master carries the guide, and no instrument."""

    def leave(self) -> None:
        """Withdraw the guide if it is on an axis, and park. Raises PRO-002 unless each is confirmed."""
        if (on := self.place.axis) is not None:
            self.retreat(on.trajectory)
        self.park()

    @property
    def way_home(self) -> tuple[str, ...]:
        """Motions of `leave`, in words; without a home, before set-up, there is none."""
        place = self.place
        retreat = place.trajectory and f"the guide retreats from {place.trajectory} along its axis"
        away = self._log.home_rad and not place.is_home
        park = away and f"the {self.spoken_name} goes home the way it came"
        return tuple(words for words in (retreat, park) if words)

    def retreat(self, trajectory: str) -> None:
        """Withdraw the guide once the operator has confirmed it. Raises PRO-002 and as `withdraw`."""
        way_out = [self.withdraw_motion(self._axis_of(trajectory))]
        self.supervised.confirm(
            Topic.RETREAT, f"Withdraw the guide from {trajectory} along its axis?", way_out, trajectory
        )
        self.withdraw(trajectory)

    def record_found_on_axis(self, axis: InsertionAxis) -> None:
        """Journal that the guide was found on an axis, in case the original line was lost."""
        joints_rad, plain = list(self.joints_rad()), axis.as_plain()
        self._log.note(
            Entry.PLACED, joints_rad=joints_rad, at_home=False, trajectory=axis.trajectory, axis=plain
        )

    def _axis_of(self, trajectory: str) -> InsertionAxis:
        axis = self.place.axis
        if axis is None or axis.trajectory != trajectory:
            on = self.place.trajectory or "no trajectory"
            raise GUIDE_HELD_AT_ENTRY(f"the guide is not on {trajectory}", expected=trajectory, got=on)
        return axis

    def _require_allowed(self, motion: PlannedMotion) -> None:
        """Raise if a motion would leave the guide's axis, or if the guide has been pushed off it."""
        on, axis = self.place.axis, motion.axis
        if axis is None or (on is not None and axis.trajectory != on.trajectory):
            self._require_outside(motion.what)
        else:
            self._require_free(motion.what)
            for pose in (self.tool_pose(), axis.held):
                (on or axis).check_on_axis(pose)

    def _require_outside(self, what: str) -> None:
        self._require_free(what)
        for held in self.place.hold_reasons:
            raise GUIDE_HELD_AT_ENTRY(f"{what}: {held}", expected=f"a retreat along {self.place.trajectory}")

    def _require_free(self, what: str) -> None:
        """Raise TOOL-001 while an instrument, or another arm, is in the guide or on its axis."""
        self.instrument.require_out(what)
        for other in self._others:
            if other.place.is_on_axis:
                raise INSTRUMENT_IN_GUIDE(f"{what}: the {other.name} is on the axis of the guide")

    def _via_home(self, direct: PlannedMotion) -> PlannedMotion:
        """Return a motion that may lead via home if its direct path is not clear."""
        if self._log.home_rad is None:
            return direct
        return replace(direct, replacement=(self.home_motion(), direct))

    def _line_motion(
        self, what: MotionKind, pose: Transform, line: LineMove, axis: InsertionAxis | None = None
    ) -> PlannedMotion:
        return PlannedMotion(what, self.carries, tuple(pose.translation_mm.tolist()), (line,), axis=axis)

    def _commanded_pose(
        self, pose: Transform, arriving: Sides, near_rad: JointVector | None = None
    ) -> Transform:
        return self.calibrated.pose_to_command(
            pose, self.flange_from_tool, lambda: near_rad or self.joints_rad(), arriving
        )
