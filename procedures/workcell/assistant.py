"""The assistant: the second arm, which holds a ball for the stereo head, and the instrument for the guide.

Its poses are in its own base, ASSISTANT, and `base` leads from there to the robot frame; its driver, as that
of any arm, has them as ROBOT.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from procedures.journal.journal import Entry
from procedures.journal.results import FramedPose
from procedures.operator.question import Topic
from procedures.strategies.strategy import ONE_SIDE, Sides, approach_joints
from procedures.workcell.arm_history import ArmLog, HeldInstrument, InsertionAxis, MotionKind
from procedures.workcell.arms import Arms
from procedures.workcell.errors import GUIDE_HELD_AT_ENTRY, INSTRUMENT_IN_GUIDE, OtherArmUnknown
from procedures.workcell.motions import PlannedMotion, joints_after
from procedures.workcell.supervised_arm import SupervisedArm
from ronna_hw.arm.clearance.bodies import ARMS_OWN_RADII, Bodies, Capsule, Part, Surroundings
from ronna_hw.arm.clearance.sweep import sweep
from ronna_hw.arm.pose import Pose
from ronna_hw.calibrated_arm.error_budget import PER_AXIS
from ronna_hw.calibration import HolderCalibration
from ronna_hw.config import Calibrations
from ronna_hw.devices import JointMove, LineMove, Motion
from ronna_hw.devices.contact import (
    BORE_SPEED_MM_S,
    INSERTION_SPEED_MM_S,
    Drilled,
    DrillLimits,
    Inserted,
    Insertion,
    InsertsInstruments,
    StatesForceError,
    TellsFeed,
)
from ronna_hw.devices.errors import NotInTheatre
from ronna_hw.devices.readings import ArmReading
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import MASTER
from ronna_hw.vectors import JointVector, Vector3, vector3

POST_MM, CLAMP_MM, INSTRUMENT_MM = 12.0, 14.0, 2.5  # radii of the holder's bodies, as drawn
POST, CLAMP, INSTRUMENT = "post of the holder", "clamp of the holder", "instrument"
AT_GUIDE = (POST, CLAMP, INSTRUMENT)  # these come close to the guide when the instrument is led into it
# Safety against an instrument drawn out too fast (U).
WITHDRAWAL_SPEED_MM_S = 10.0  # straight out: nothing is ahead of the tip
OFF_SKIN_SPEED_MM_S = 40.0  # of a withdrawal, the tip off the skin: in the bore and above, nothing holds it
# By which a moved cart, seen by one look at the frame on its arm, may be misplaced (U).
# Safety against an arm on a cart that was moved.
ONE_LOOK_MM = 5.0
TURNED_SHARE = 0.25  # of the way of its frame, by which a cart that turned has moved other parts differently
TURNED_CART = 2.0  # a cart that turned moves parts of its arm farther than the frame that shows it


class DrillPlan(NamedTuple):
    """Feed of a drill along its axis: places from the start of the axis, speed, and forces."""

    from_mm: float
    to_mm: float
    feed_mm_s: float
    limit_N: float
    limits: DrillLimits


class GuidedStretch(NamedTuple):
    """Part of the way from the start of an axis in which the tip is inside the guide, or off the skin."""

    start_mm: float
    end_mm: float


def holder_bodies(holder: HolderCalibration) -> tuple[Part, ...]:
    """Return the bodies of an empty holder, flange frame."""
    middle = holder.flange_from_clamp.translation_mm
    post = Capsule((0.0, 0.0, 0.0), holder.flange_from_ball_mm, POST_MM)
    return (Part(POST, post), Part(CLAMP, Capsule(middle, middle, CLAMP_MM)))


def _as_pose(transform: Transform) -> Pose:
    return Pose.from_matrix(transform.as_matrix().tolist())


def _named_in(frame: Frame, pose: Transform) -> Transform:
    return Transform(frame, pose.source, pose.rigid)


def _as_any_arm(pose: Transform) -> Transform:
    """Return a pose in the assistant's base as its driver and record have it. Raises FRM-001 for another."""
    return _named_in(Frame.ROBOT, Transform.of(Frame.ASSISTANT, Frame.ASSISTANT) @ pose)


class Assistant(SupervisedArm):
    """The assistant of a workcell."""

    def __init__(
        self,
        role: str,
        log: ArmLog,
        arms: Arms,
        calibrations: Calibrations,
        insertion_force_N: float | None,
    ) -> None:
        """Supervise the arm of this role; an insertion stops at `insertion_force_N`, if the arm senses it.

        Raises DEV-007 without records of the arm and its holder.
        """
        holder = calibrations.assistant_holder
        if holder is None or not calibrations.arms.keys() >= {MASTER, role}:
            raise NotInTheatre(
                "two arms need the records of both, and of the assistant's holder",
                expected="calibration.arm, calibration.assistant_arm, calibration.assistant_holder",
                action="Add them to the theatre file, or omit --dual.",
            )
        super().__init__(role, log, arms, calibrations.arms, role, holder.frame)
        self.holder: HolderCalibration = holder
        self._insertion_force_N = insertion_force_N
        self._around: tuple[Surroundings, JointVector | None] | None = None  # robot frame
        self.inserted: Inserted | None = None  # at the end of the last insertion, if its force was watched
        self._drill: DrillPlan | None = None  # of the motion under way, if it is one of a drill
        self.drilled: Drilled | None = None  # of its feed so far, or the last one; None if nothing was fed

    @property
    def carries(self) -> str:
        return "the holder"

    @property
    def base(self) -> Transform:
        """Pose ROBOT <- ASSISTANT, by the journal. Raises DUAL-003 before it is known."""
        if self.history.base is None:
            raise OtherArmUnknown(
                "where the assistant stands is not known", action="Run base_to_base first: nothing has moved."
            )
        return self.history.base

    def place_base(self, robot_from_base: Transform, uncertain_mm: float = 0.0) -> None:
        """Take the base as known: from now on either arm may move, watched with the other.

        `uncertain_mm` is by how much the arm may be elsewhere.
        """
        is_first = not self._arms.placed.is_placed(self.role)
        self.record_base(robot_from_base, uncertain_mm)
        self._arms.place(self.role, _as_pose(robot_from_base), uncertain_mm)
        if is_first:  # until its own surroundings are declared
            known = self._with_own_radii(self._arms.placed.around[MASTER])
            bare = replace(known, obstacles=(), corridor=None, zone=None, tool=self.tool())
            self._arms.surround(self.role, bare)
        self._allow_contact()

    def restore_home(self, home_rad: JointVector) -> None:
        """Restore the home and, also if void by now, the base: from there the way out begins."""
        super().restore_home(home_rad)
        if (base := self.history.base) is not None:
            self.place_base(base, self.history.base_uncertain_mm)

    def surround(self, around: Surroundings, near_rad: JointVector | None = None) -> None:
        """Set what surrounds the arm, in the robot frame; its tool is its own.

        Clearance is exact near `near_rad`, by default home.
        """
        around = self._with_own_radii(around)
        self._around = around, near_rad
        self._arms.surround(self.role, self.surroundings(around, near_rad))

    def _with_own_radii(self, around: Surroundings) -> Surroundings:
        """Return surroundings for this arm: the radii measured on the master hold for one of its model."""
        same = self.arm.kinematics.name == self._arms[MASTER].kinematics.name
        return around if same else replace(around, radii=ARMS_OWN_RADII)

    def shift_room(self, by: Transform, on_cart: Collection[str]) -> None:
        """Take the base as moved with the room, against a moved cart of the master.

        What surrounds the arm stands to it as before. A later program has the former place, and is told how
        far the arm may be from it.
        """
        if not self._arms.placed.is_placed(self.role):
            return
        before, after = self.base, by @ self.base
        uncertain_mm = self.history.base_uncertain_mm
        self.record_base(before, uncertain_mm + math.dist(before.translation_mm, after.translation_mm))
        self._arms.place(self.role, _as_pose(after), uncertain_mm + ONE_LOOK_MM)

    def doubt(self, seen_apart_mm: float) -> None:
        """Keep more distance between the arms: this one was seen elsewhere than its base has it."""
        if self._arms.placed.is_placed(self.role):
            self.place_base(self.base, self.history.base_uncertain_mm + TURNED_CART * seen_apart_mm)

    def follow(self, way_mm: ArrayLike) -> None:
        """Take the arm for as far away (3,) mm, robot frame, as its frame was seen from its place.

        For the way home only: its cart may have turned as well.
        """
        way = np.asarray(way_mm, dtype=float)
        uncertain_mm = ONE_LOOK_MM + TURNED_SHARE * float(np.linalg.norm(way))
        self.place_base(self.base.displace(way), self.history.base_uncertain_mm + uncertain_mm)
        self._surround_again()

    def _surround_again(self) -> None:
        if self._around is not None:
            self.surround(*self._around)

    def record_base(self, robot_from_base: Transform, uncertain_mm: float = 0.0) -> None:
        """Journal the base if it is new, before either arm moves: the way out needs it."""
        known, pose = self._log.history, FramedPose.of(robot_from_base)
        same = known.base is not None and pose == FramedPose.of(known.base)
        if not same or uncertain_mm != known.base_uncertain_mm:
            plain = pose.model_dump(mode="json")
            self._log.write(Entry.BASE, robot_from_base=plain, uncertain_mm=uncertain_mm)

    def require_on_axis(self) -> float:
        """Return how far (mm) the clamp is along the axis that it is on, 0.0 on none.

        Raises PRO-015 if it is beside that: it was jogged, or pushed.
        """
        if (on := self.place.axis) is None:
            return 0.0
        clamp = self.flange_pose(self.joints_rad(), on.arriving) @ self.flange_from_clamp
        on.check_on_axis(clamp, "the assistant")
        return on.travel_from_start_mm(clamp)

    def flange_pose(self, joints_rad: JointVector, arrived: Sides = None) -> Transform:
        """Return the flange, ASSISTANT <- FLANGE, by its calibration if there is one; see `Sides`."""
        return _named_in(Frame.ASSISTANT, super().flange_pose(joints_rad, arrived))

    def flange_joints(self, flange: Transform, near: JointVector, arriving: Sides = None) -> JointVector:
        """Return the joints for ASSISTANT <- FLANGE, in the branch of `near`. Raises ARM-001 to ARM-003."""
        return self.calibrated.compensate(_as_any_arm(flange), near, arriving).joints_rad

    def surroundings(
        self, around: Surroundings, near_rad: JointVector | None = None, tip_mm: float | None = None
    ) -> Surroundings:
        """Return surroundings given in the robot frame for the assistant, with the tool that it carries.

        They are exact near `near_rad`, by default home; see `CalibratedArm.as_controller_sees`. `tip_mm` as
        for `tool`.
        """
        to_base = _as_pose(self.base.inverse())
        seen = self.calibrated.as_controller_sees(around.moved(to_base), near_rad or self.home_rad)
        return replace(seen, tool=self.tool(tip_mm))

    @property
    def flange_from_clamp(self) -> Transform:
        """Pose FLANGE <- clamp by the record."""
        return self.holder.flange_from_clamp.transform(Frame.FLANGE, Frame.TOOL)

    @property
    def ball_error_mm(self) -> float:
        """Standard error of the ball beside the clamp, per axis: both have that of the record."""
        return math.sqrt(2.0) * PER_AXIS * self.holder.stated_error_mm

    def clamp_pose(self, joints_rad: JointVector, arrived: Sides = None) -> Transform:
        """Return the clamp in the robot frame."""
        return self.base @ self.flange_pose(joints_rad, arrived) @ self.flange_from_clamp

    def clamp_joints(self, clamp: Transform, near: JointVector, arriving: Sides = None) -> JointVector:
        """Return the joints for a clamp in the robot frame. Raises ARM-001 to ARM-003."""
        flange = self.base.inverse() @ clamp @ self.flange_from_clamp.inverse()
        return self.flange_joints(flange, near, arriving)

    def axis_in_base(self, axis: InsertionAxis) -> InsertionAxis:
        """Return an axis given in the robot frame in that of the assistant's base."""
        return replace(axis, held=self.base.inverse() @ axis.held)

    def explain_blocked(self, motions: Sequence[PlannedMotion], start_rad: JointVector) -> str:
        """Explain why motions one after the other are not possible or not clear, or return ''."""
        at_rad, arm = start_rad, self._arm
        for motion in motions:
            for leg in motion.legs:
                try:
                    refused = arm.preview(leg, start_rad=at_rad).refused
                    at_rad = joints_after(arm.kinematics, leg, at_rad)
                except LimitError as error:
                    return error.meaning
                if refused is not None:
                    return f"{refused.first} at {refused.second}"
        return ""

    def rests_clear(self, joints_rad: JointVector, tip_mm: float) -> bool:
        """Return whether the arm, with such an instrument in its holder, keeps its margin where it rests.

        A path is checked leniently where it begins: there, bodies that are too close may stay so.
        """
        assert self._around is not None, "what surrounds the assistant is known first"
        surroundings = self.surroundings(self._around[0], joints_rad, tip_mm)
        gaps_mm = sweep(Bodies(self.arm.kinematics, surroundings), [joints_rad]).gaps_mm
        return not (gaps_mm < surroundings.margin_mm).any()

    def hold_instrument(self, held: HeldInstrument) -> None:
        """Take an instrument as held, which may come close to the guide from now on.

        The journal has it before anybody is asked to put it in.
        """
        self._write_held(held)
        self._take_into_account()

    def _write_held(self, held: HeldInstrument) -> None:
        more = {} if held.drill is None else {"drill": held.drill.model_dump(mode="json")}
        self._log.write(
            Entry.HELD,
            trajectory=held.trajectory,
            held=True,
            tip_mm=held.tip_mm,
            at_bore=list(held.at_bore),
            **more,
        )

    def record_drill(self, *, may_turn: bool) -> None:
        """Record that the drill in the holder is about to be switched on, or was switched off, and where."""
        if (held := self.history.held) is None or held.drill is None:
            return
        reached_mm = held.drill.reached_mm
        if not may_turn and self.place.axis is not None:  # also from beside the axis: it is off in any case
            reached_mm = self.drill_tip_mm()
        drill = held.drill.model_copy(update={"may_turn": may_turn, "reached_mm": reached_mm})
        self._write_held(replace(held, drill=drill))

    def drill_tip_mm(self, joints_rad: JointVector | None = None) -> float:
        """Return how far behind the entry the tip of the drill is at joint angles, by default the present."""
        axis, held = self.place.axis, self.history.held
        assert axis is not None, "the drill is on its axis"
        assert held is not None, "the drill is in the holder"
        assert held.drill is not None, "a drill is in the holder"
        flange = self.flange_pose(self.joints_rad() if joints_rad is None else joints_rad, axis.arriving)
        return axis.travel_from_start_mm(flange @ self.flange_from_clamp) - held.drill.entry_mm

    def drilled_mm(self, trajectory: str) -> float | None:
        """Return how far behind the entry a drill was before at a trajectory, None if none was."""
        return self.history.drilled.get(trajectory)

    def release_instrument(self) -> None:
        """Take the holder as empty, once that is confirmed; the arm keeps its distance again."""
        if (held := self.history.held) is not None:
            self._log.write(Entry.HELD, trajectory=held.trajectory, held=False)
            self._take_into_account()

    def doubt_tool(self) -> None:
        """Do nothing: the holder is not changed during a case."""

    def _take_into_account(self) -> None:
        self._allow_contact()
        self._surround_again()

    def _allow_contact(self) -> None:
        """Let the instrument in the holder come close to the guide, and nothing without one."""
        held = self.history.held
        self._arms.placed.allow_contact(
            MASTER, self.role, *((), ()) if held is None else (held.at_bore, AT_GUIDE)
        )

    def tool(self, tip_mm: float | None = None) -> tuple[Part, ...]:
        """Return the bodies of the holder and of the instrument in it, flange frame.

        `tip_mm` is how far its tip is beyond the clamp, by default that of the instrument held, if any.
        """
        bodies, held = holder_bodies(self.holder), self.history.held
        if tip_mm is None and held is not None:
            tip_mm = held.tip_mm
        if not tip_mm:
            return bodies
        clamp = self.flange_from_clamp
        middle, tip = (vector3(clamp.apply((0.0, 0.0, z))) for z in (0.0, tip_mm))
        return (*bodies, Part(INSTRUMENT, Capsule(middle, tip, INSTRUMENT_MM), True))

    def settle(self, joints_rad: JointVector, arriving: Sides = ONE_SIDE) -> ArmReading:
        """Move to joint angles, each joint arriving from its given side."""
        return self.supervised.carry_out(self.settle_motion(joints_rad, arriving))

    def settle_motion(self, joints_rad: JointVector, arriving: Sides = ONE_SIDE) -> PlannedMotion:
        """Return the motion that `settle` would make."""
        before = JointMove(approach_joints(joints_rad, arriving or ONE_SIDE), settles=False)
        return self.joint_motion(MotionKind.SETTLE, before, JointMove(joints_rad))

    def insert_motion(
        self, axis: InsertionAxis, near_rad: JointVector | None = None, guided: GuidedStretch | None = None
    ) -> PlannedMotion:
        """Return the motion that `insert` would make, in the branch of `near_rad` (default: current)."""
        legs = self._lines_in(axis, axis.travel_mm, guided, near_rad)
        return self._along(MotionKind.INSERT, axis, *legs)

    def insert(self, axis: InsertionAxis, guided: GuidedStretch | None = None) -> ArmReading:
        """Lead the instrument straight along the axis to the held pose of the clamp, faster where guided."""
        self.inserted = None
        return self.supervised.carry_out(self.insert_motion(axis, guided=guided))

    def _lines_in(
        self,
        axis: InsertionAxis,
        travel_mm: float,
        guided: GuidedStretch | None,
        near_rad: JointVector | None = None,
    ) -> list[LineMove]:
        """List the lines to a place on the axis: if guided, to the mouth of the bore, inside it, and on."""
        end = self._line(axis, travel_mm, INSERTION_SPEED_MM_S, near_rad)
        if guided is None:
            return [end]
        mouth = self._line(axis, guided.start_mm, INSERTION_SPEED_MM_S, near_rad)
        return [mouth, self._line(axis, guided.end_mm, BORE_SPEED_MM_S, near_rad), end]

    def lead_in(self, axis: InsertionAxis, travel_mm: float, guided: GuidedStretch, led: str) -> ArmReading:
        """Lead a tool, `led` in words, straight along the axis to a place short of its end."""
        self.inserted = None
        legs = self._lines_in(axis, travel_mm, guided)
        return self.supervised.carry_out(self._partial_motion(axis, travel_mm, legs, led))

    def drill(self, axis: InsertionAxis, plan: DrillPlan) -> None:
        """Feed the drill along the axis until it breaks through, at most to the plan's end.

        `drilled` tells of the feed, whichever way it ends. Raises ARM-013 to ARM-015 as the arm, and what
        stops an insertion.
        """
        self.drilled = None
        self._drill = plan
        try:
            line = self._line(axis, plan.to_mm, plan.feed_mm_s)
            self.supervised.carry_out(self._partial_motion(axis, plan.to_mm, [line], "the drill"))
        finally:
            self._drill = None

    def _partial_motion(
        self, axis: InsertionAxis, travel_mm: float, legs: Sequence[LineMove], led: str
    ) -> PlannedMotion:
        to_mm = vector3(axis.pose_at(travel_mm).translation_mm)
        return PlannedMotion(MotionKind.INSERT, led, to_mm, tuple(legs), axis=axis)

    def withdraw_motion(self, guided: GuidedStretch | None = None) -> PlannedMotion:
        """Return the motion of the instrument straight back out of the guide. Raises PRO-014 on no axis."""
        axis = self.place.axis
        if axis is None:
            raise GUIDE_HELD_AT_ENTRY("the assistant is on no axis", expected="the axis of a trajectory")
        legs = [] if guided is None else [self._line(axis, guided.end_mm, WITHDRAWAL_SPEED_MM_S)]
        last_mm_s = OFF_SKIN_SPEED_MM_S if guided else WITHDRAWAL_SPEED_MM_S
        return self._along(MotionKind.WITHDRAW, axis, *legs, self._line(axis, 0.0, last_mm_s))

    @property
    def leads_instrument(self) -> bool:
        """Whether the assistant is on an axis, with an instrument in the guide."""
        return self.place.is_on_axis

    def lead_out(self, doubt: str = "", guided: GuidedStretch | None = None) -> None:
        """Withdraw the instrument once the operator, told of a `doubt`, has confirmed it."""
        motion = self.withdraw_motion(guided)
        subject = f"May the assistant lead {self._led} straight out of {motion.trajectory}?"
        if doubt:
            subject += f" {doubt[0].upper()}{doubt[1:]}."
        self.supervised.confirm(Topic.RETREAT, subject, [motion], motion.trajectory)
        self.supervised.carry_out(self.withdraw_motion(guided))

    @property
    def _led(self) -> str:
        held = self.history.held
        return "the instrument" if held is None else f"the {held.name}"

    @property
    def way_home(self) -> tuple[str, ...]:
        return ("the assistant goes home",) if self.place.is_out else ()

    @property
    def insertion_limit_N(self) -> float | None:
        """Force on the instrument that stops its insertion; None if the arm senses none."""
        return self._insertion_force_N if self.senses_force else None

    def _drive_leg(self, leg: Motion, motion: PlannedMotion) -> ArmReading:
        if motion.axis is None:
            return self._arms.move(self.role, leg)
        if self.has_passed(leg, motion):
            return self._arm.read_state()
        limit_N = self.insertion_limit_N if self._drill is None else self._drill.limit_N
        if limit_N is not None and (insertion := self.force_limited(leg, motion, limit_N)):
            before = self._fed
            try:
                inserted = self._arms.insert(self.role, insertion)
            finally:
                if (fed := self._fed) is not None and fed is not before:
                    self.drilled = fed if self.drilled is None else fed.after(self.drilled)
            ends = [one for one in (self.inserted, inserted) if one is not None]  # of stretches so far
            peaks_N = [one.peak_force_N for one in ends if one.peak_force_N is not None]
            self.inserted = replace(inserted, peak_force_N=max(peaks_N, default=None))
            return inserted.reading
        return self._arms.move(self.role, leg, with_instrument=True)

    @property
    def _fed(self) -> Drilled | None:
        """Feed of a drill in the arm's last insertion."""
        arm = self._arm
        return arm.drilled if isinstance(arm, TellsFeed) else None

    def has_passed(self, leg: Motion, motion: PlannedMotion) -> bool:
        """Return whether the instrument is beyond a leg of its way, as when it was stopped on a later one.

        It never goes back to where a leg ends.
        """
        axis = motion.axis
        if axis is None or leg is motion.legs[-1] or not isinstance(leg, LineMove):
            return False
        flange = _named_in(Frame.ASSISTANT, self._arm.kinematics.flange_pose(self.joints_rad()))
        clamp = flange @ self.flange_from_clamp
        end = _named_in(Frame.ASSISTANT, leg.target)
        beyond_mm = axis.travel_from_start_mm(clamp) - axis.travel_from_start_mm(end)
        return beyond_mm > 0.0 if motion.what is MotionKind.INSERT else beyond_mm < 0.0

    def force_limited(self, leg: Motion, motion: PlannedMotion, limit_N: float) -> Insertion | None:
        """Return a leg of an insertion as one that its force limit stops; None for other legs."""
        inserts = motion.what is MotionKind.INSERT
        if not inserts or not isinstance(leg, LineMove) or leg.flange_from_tool is None:
            return None
        assert motion.axis is not None, "an insertion leads along an axis"
        kept_N = limit_N - self.force_error_N
        if (drill := self._drill) is not None:
            start = self._line(motion.axis, drill.from_mm, drill.feed_mm_s).target
            return Insertion(
                leg.target, leg.flange_from_tool, drill.feed_mm_s, kept_N, start, drill=drill.limits
            )
        in_bore = leg is not motion.legs[-1] and leg is not motion.legs[0]
        speed_mm_s = BORE_SPEED_MM_S if in_bore else INSERTION_SPEED_MM_S
        start = self._line(motion.axis, 0.0, INSERTION_SPEED_MM_S).target
        return Insertion(leg.target, leg.flange_from_tool, speed_mm_s, kept_N, start, in_bore=in_bore)

    @property
    def force_error_N(self) -> float:
        """Two standard errors of the force on the instrument, by which its limits are kept."""
        arm = self._arm
        return arm.force_error_N if isinstance(arm, StatesForceError) else 0.0

    def read_force_N(self) -> Vector3 | None:
        """Return the force on the holder now, ASSISTANT, without tare; None from an arm that states none."""
        return self._arm.read_state().force_N

    @property
    def senses_force(self) -> bool:
        """Whether the arm senses the force on the instrument."""
        arm = self._arm
        return isinstance(arm, InsertsInstruments) and arm.senses_force

    def _line(
        self, axis: InsertionAxis, travel_mm: float, speed_mm_s: float, near_rad: JointVector | None = None
    ) -> LineMove:
        """Return the line to a place of the clamp on an axis, `travel_mm` from its start."""
        clamp = _as_any_arm(axis.pose_at(travel_mm))
        commanded = self.calibrated.pose_to_command(
            clamp, self.flange_from_clamp, lambda: near_rad or self.joints_rad(), axis.arriving
        )
        share = min(1.0, speed_mm_s / self._arm.limits().line_speed_mm_s)
        return LineMove(commanded, self.flange_from_clamp, share)

    def _along(self, what: MotionKind, axis: InsertionAxis, *legs: LineMove) -> PlannedMotion:
        end = axis.held if what is MotionKind.INSERT else axis.start
        return PlannedMotion(what, self._led, vector3(end.translation_mm), legs, axis=axis)

    def _require_allowed(self, motion: PlannedMotion) -> None:
        """Raise unless a motion with an instrument in the guide leads along the axis that it is on."""
        on, axis = self.place.axis, motion.axis
        if axis is not None and (on is None or axis.trajectory == on.trajectory):
            self.require_on_axis()  # a straight line from beside the axis would bend the instrument
            return
        if on is not None:
            raise GUIDE_HELD_AT_ENTRY(
                f"{motion.what}: the assistant holds an instrument at the guide",
                expected=f"a retreat along {on.trajectory}",
            )
        if (inside := self._arms.instrument_inside()) is not None:
            raise INSTRUMENT_IN_GUIDE(f"{motion.what}: an instrument is in the guide, and in {inside}")
