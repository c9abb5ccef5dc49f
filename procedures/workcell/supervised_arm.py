"""An arm of the workcell: place and home by the journal, calibrated kinematics, supervised motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial

from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry
from procedures.operator.question import Topic
from procedures.strategies.strategy import ONE_SIDE, Sides, approach_joints
from procedures.workcell.arm_history import ArmHistory, ArmLog, ArmPlace, MotionKind, PlaceKind, stands_at
from procedures.workcell.arms import Arms
from procedures.workcell.device_views import ArmView
from procedures.workcell.motions import PlannedMotion
from procedures.workcell.supervised_motion import SupervisedMotion
from procedures.workcell.tools import calibrated_arm
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibration import ArmCalibration
from ronna_hw.devices import JointMove, Motion, RobotArm
from ronna_hw.devices.axis_loads import LOAD_CYCLES, AxisLoads, TellsLoads
from ronna_hw.devices.lifecycle import RUNNING, Lifecycle
from ronna_hw.devices.readings import ArmReading, LinkStatistics
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector


class SupervisedArm(ABC):
    """One arm of the theatre, with its history in the journal.

    `name` is that of its device, `spoken_name` what messages call it.
    """

    def __init__(
        self,
        role: str,
        log: ArmLog,
        arms: Arms,
        records: Mapping[str, ArmCalibration],
        name: str,
        frame: str,
        spoken_name: str = "",
    ) -> None:
        """Supervise the arm of a role; `records` are the calibrations of all arms, by role.

        `frame` is the name that the tracker has for the frame on the arm.
        """
        self.role, self.name, self.frame, self._log, self._arms = role, name, frame, log, arms
        self.spoken_name = spoken_name or name
        self._calibrated = partial(calibrated_arm, records=records, role=role)
        self._computed = self._calibrated(self._arm.kinematics)
        self.supervised = SupervisedMotion(
            self.spoken_name, role, log, arms, self._require_allowed, self._drive_leg
        )

    @property
    @abstractmethod
    def carries(self) -> str:
        """Name of the load, as questions name it."""

    @abstractmethod
    def _require_allowed(self, motion: PlannedMotion) -> None:
        """Raise the reason against a motion, if there is one."""

    def _drive_leg(self, leg: Motion, motion: PlannedMotion) -> ArmReading:
        """Make one leg of a motion, while the other arms rest."""
        return self._arms.move(self.role, leg)

    @property
    def arm(self) -> ArmView:
        """Arm without the methods that move it."""
        return ArmView(self._arm)

    @property
    def _arm(self) -> RobotArm:
        return self._arms[self.role]

    @property
    def calibrated(self) -> CalibratedArm:
        """Arm as it is computed; once connected, a controller may state kinematics of its own arm."""
        kinematics = self._arm.kinematics
        if kinematics is not self._computed.nominal:
            self._computed = self._calibrated(kinematics)
        return self._computed

    def joints_rad(self) -> JointVector:
        """Measure the joint angles, rad."""
        return self._arm.read_state().joints_rad

    @property
    def streaming(self) -> bool:
        """Whether the arm's set-point stream is running. Otherwise it cannot be moved."""
        return self._arm.observe().state in RUNNING

    def link_statistics(self) -> LinkStatistics:
        """Return the statistics of the arm's link since it was last activated."""
        return self._arm.link_statistics()

    def flange_pose(self, joints_rad: JointVector, arrived: Sides = None) -> Transform:
        """Return the flange in the arm's base, by its calibration if there is one; see `Sides`."""
        return self.calibrated.flange_pose(joints_rad, arrived)

    @property
    def history(self) -> ArmHistory:
        """History of the arm and of the work done with it, from the journal."""
        return self._log.history

    @property
    def place(self) -> ArmPlace:
        """Journalled position of the arm, and whether an instrument may be inside."""
        return self._log.history.place

    @property
    def home_rad(self) -> JointVector:
        """Joint angles at set-up, rad. Raises PRO-001 before set-up."""
        if self._log.home_rad is None:
            raise StepRefused(f"the {self.spoken_name} has no home position yet", action="Run set_up first.")
        return self._log.home_rad

    @property
    def settled_home(self) -> bool:
        """Whether the arm is at home with each joint having arrived from its usual side."""
        return self.supervised.ended is MotionKind.HOME and self.place.is_home

    @property
    def rest_sides(self) -> tuple[int, ...] | None:
        """Sides of its backlash on which each joint rests, None if unknown.

        They are known at home and at the end of an axis, if this program has moved the arm there to the end.
        """
        if self.settled_home:
            return ONE_SIDE
        axis = self.place.axis
        return axis.arriving if axis is not None and self.supervised.ended is MotionKind.INSERT else None

    def set_home(self) -> JointVector:
        """Make the present position home, for parking and for detours when a direct path is not clear."""
        home_rad = self._log.home_rad = self.joints_rad()
        self._log.note(Entry.PLACED, joints_rad=list(home_rad), at_home=True)
        return home_rad

    def restore_history(self, history: ArmHistory) -> None:
        """Restore the arm's history in a resumed run. Nothing moves."""
        self._log.history = history

    def restore_home(self, home_rad: JointVector) -> None:
        """Restore the home of a resumed run. Nothing moves."""
        self._log.home_rad = home_rad

    def compare_place(self) -> None:
        """Compare the measured joints with home, and journal the place if the journal disagrees.

        Somebody may have jogged the arm. Whether it left its axis is checked before the next motion along
        that. Raises the arm's error if it reports no joints.
        """
        if self._log.home_rad is None:
            return
        joints_rad = self.joints_rad()
        at_home = stands_at(joints_rad, self._log.home_rad)
        if at_home != self.place.is_home or self.place.place_kind is PlaceKind.UNKNOWN:
            self.supervised.ended = None
            self._log.note(Entry.PLACED, joints_rad=list(joints_rad), at_home=at_home)

    def rests_apart(self, joints_rad: JointVector) -> bool:
        """Return whether the arm, at these joints, would keep its distance from the others at rest."""
        return self._arms.rests_apart(self.role, joints_rad)

    def read_load(self, cycles: int = LOAD_CYCLES) -> AxisLoads | None:
        """Average the controller's signals of the load since the arm rests; None if its driver has none.

        Raises the arm's error if it does not rest.
        """
        arm = self._arm
        return arm.read_loads(cycles, since_rest=True) if isinstance(arm, TellsLoads) else None

    def start(self) -> None:
        """Start the arm's correction stream, if it is configured. Raises PRO-002."""
        self.supervised.start()

    def hold(self) -> None:
        """Hold still, supervised by the link, until the next motion."""
        if self._arm.state is Lifecycle.ACTIVE:
            self._arm.stop()
            self.supervised.note_hold()

    def expect_jogging(self) -> None:
        """Allow for somebody having jogged the arm: it has to settle anew, and to be confirmed anew."""
        self.supervised.ended = None
        self.supervised.reset_confirmation()

    @abstractmethod
    def doubt_tool(self) -> None:
        """Take the tool for unknown after a fault, if the arm carries tools."""

    @abstractmethod
    def shift_room(self, by: Transform, on_cart: Collection[str]) -> None:
        """Follow the room as it moves against a moved cart of the master, which carries bodies by name."""

    @property
    def leads_instrument(self) -> bool:
        """Whether it may hold an instrument in the guide, which then only it can lead out."""
        return False

    @abstractmethod
    def lead_out(self, doubt: str = "") -> None:
        """Withdraw the instrument that the arm leads, if any, once the operator has confirmed it.

        The question names a `doubt`. Raises PRO-002, and as a motion along the axis.
        """

    def leave(self) -> None:
        """Go home from wherever it is, with no instrument in the guide. Raises PRO-002."""
        self.return_home()

    @property
    @abstractmethod
    def way_home(self) -> tuple[str, ...]:
        """Motions of `leave`, in the words told to the operator before they begin; none at home."""

    def joint_motion(self, what: MotionKind, *legs: JointMove) -> PlannedMotion:
        """Return a motion by joint moves, with what the arm carries."""
        return PlannedMotion(what, self.carries, legs[-1].target_rad, legs)

    def go_motion(self, joints_rad: JointVector) -> PlannedMotion:
        return self.joint_motion(MotionKind.GO, JointMove(joints_rad))

    def go(self, joints_rad: JointVector) -> ArmReading:
        """Move to joint angles, by the planned detour if the direct path is not clear. Raises ARM-007."""
        return self.supervised.carry_out_with_detour(self.go_motion(joints_rad))

    def home_motion(self) -> PlannedMotion:
        """Return the motion that `go_home` would make."""
        home_rad = self.home_rad
        before = JointMove(approach_joints(home_rad, ONE_SIDE), settles=False)
        return self.joint_motion(MotionKind.HOME, before, JointMove(home_rad))

    def return_motion(self) -> PlannedMotion:
        """Return the motion that `return_home` would make."""
        home = self.home_motion()
        trail = reversed(self.history.trail)
        back = tuple(self.joint_motion(MotionKind.BACK, JointMove(joints_rad)) for joints_rad in trail)
        return replace(home, replacement=back and (*back, home), detour="back the way the arm came")

    def park(self, occasion: str = "") -> ArmReading:
        """Return home once the operator has confirmed it, on an occasion. Raises PRO-002."""
        subject = f"Drive the {self.spoken_name} home {occasion}".rstrip() + "?"
        self.supervised.confirm(Topic.PARK, subject, [self.return_motion()])
        return self.return_home()

    def go_home(self) -> ArmReading:
        """Move home, each joint arriving from the same side so that small changes show there."""
        return self.supervised.carry_out(self.home_motion())

    def return_home(self) -> ArmReading:
        """Move home directly or, if that path is not clear, back the way the arm came."""
        return self.supervised.carry_out_with_detour(self.return_motion())
