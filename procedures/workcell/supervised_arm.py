"""An arm of the workcell: place and home by the journal, calibrated kinematics, supervised motion.

What holds for one arm holds for each: the workcell's own, which carries the tools, and the assistant.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from procedures.journal.errors import StepRefused
from procedures.journal.journal import Entry
from procedures.strategies.strategy import ONE_SIDE, Sides, approach_joints
from procedures.workcell.arm_history import ArmHistory, ArmLog, ArmPlace, MotionKind, PlaceKind, stands_at
from procedures.workcell.device_views import ArmView
from procedures.workcell.motions import PlannedMotion
from procedures.workcell.supervised_motion import SupervisedMotion
from procedures.workcell.tools import calibrated_arm
from ronna_hw.calibrated_arm.arm import CalibratedArm
from ronna_hw.calibration import ArmCalibration
from ronna_hw.config import MASTER
from ronna_hw.devices import Device, JointMove, Motion, RobotArm
from ronna_hw.devices.lifecycle import RUNNING
from ronna_hw.devices.readings import ArmReading, LinkStatistics
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector


class SupervisedArm(ABC):
    """One arm, with its history in the journal."""

    def __init__(
        self,
        name: str,
        log: ArmLog,
        arm: Callable[[], RobotArm],
        record: ArmCalibration | None,
        drive: Callable[[Motion, PlannedMotion], ArmReading] | None = None,
        release: Callable[[str], bool] = lambda _by: False,
        role: str = MASTER,
        other: ArmCalibration | None = None,
        look_around: Callable[[], None] = lambda: None,
    ) -> None:
        """Name the arm as messages do; `drive`, `release` and `look_around` as in `SupervisedMotion`.

        `record` is the calibration of the arm, `other` that of the arm in the other role.
        """
        self._name, self._log, self._open = name, log, arm
        self._calibrated = partial(calibrated_arm, record=record, role=role, other=other)
        self._computed = self._calibrated(arm().kinematics)
        self.supervised = SupervisedMotion(log, arm, self._require_allowed, drive, release, look_around)

    @property
    def name(self) -> str:
        """Name of the arm, as messages have it."""
        return self._name

    @property
    @abstractmethod
    def carries(self) -> str:
        """Name of the load, as questions name it."""

    @abstractmethod
    def _require_allowed(self, motion: PlannedMotion) -> None:
        """Raise the reason against a motion, if there is one."""

    @property
    def arm(self) -> ArmView:
        """Arm without the methods that move it."""
        return ArmView(self._arm)

    @property
    def _arm(self) -> RobotArm:
        return self._open()

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

    # Place and home

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
            raise StepRefused(f"the {self._name} has no home position yet", action="Run set_up first.")
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

    def restore_history(self, history: ArmHistory, home_rad: JointVector | None = None) -> None:
        """Restore the arm's history, and any known home, in a resumed run. Nothing moves."""
        if home_rad is not None:
            self._log.home_rad = home_rad
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

    def drives(self, device: Device) -> bool:
        """Return whether this is the arm that the device moves."""
        return device is self._arm

    def expect_jogging(self) -> None:
        """Allow for somebody having jogged the arm: it has to settle anew, and to be confirmed anew."""
        self.supervised.ended = None
        self.supervised.reset_confirmation()

    # Motion home

    def joint_motion(self, what: MotionKind, *legs: JointMove) -> PlannedMotion:
        """Return a motion by joint moves, with what the arm carries."""
        return PlannedMotion(what, self.carries, legs[-1].target_rad, legs)

    def home_motion(self) -> PlannedMotion:
        """Return the motion that `go_home` would make."""
        home_rad = self.home_rad
        before = JointMove(approach_joints(home_rad, ONE_SIDE))
        return self.joint_motion(MotionKind.HOME, before, JointMove(home_rad))

    def return_motion(self) -> PlannedMotion:
        """Return the motion that `return_home` would make."""
        home = self.home_motion()
        trail = reversed(self.history.trail)
        back = tuple(self.joint_motion(MotionKind.BACK, JointMove(joints_rad)) for joints_rad in trail)
        return replace(home, replacement=back and (*back, home), detour="back the way the arm came")

    def go_home(self) -> ArmReading:
        """Move home, each joint arriving from the same side so that small changes show there."""
        return self.supervised.carry_out(self.home_motion())

    def return_home(self) -> ArmReading:
        """Move home directly or, if that path is not clear, back the way the arm came."""
        return self.supervised.carry_out_with_detour(self.return_motion())
