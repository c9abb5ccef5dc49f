"""Watch over the room since the localization: frame on the arm, spheres and frame on the head clamp.

What is seen is compared with the places at the localization, and the frame on the arm with every earlier
reading.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from procedures.engine.setting import CaseMemory
from procedures.guards.base_shift import (
    GROSS_LIMIT_MM,
    BaseShift,
    base_shift,
    base_turn_rad,
    gross_shift,
    nearest_shift,
)
from procedures.guards.clamp_frame import FrameOnClamp
from procedures.guards.errors import BaseShifted, PatientUnseen, RoomMoved, RoomUndecided
from procedures.guards.room_motion import RoomMotion, describe_way
from procedures.guards.room_reading import FRAMES, RoomReading, room_reading
from procedures.guards.stability import CAREFUL_FRAMES
from procedures.planning.tracker_sight import SENSORS_MM, TrackerSight
from procedures.registration.movement import PointShift
from procedures.workcell import Workcell
from procedures.workcell.patient_frame import seen_after
from procedures.workcell.tracker_look import read_frames_at_rest
from procedures.workcell.tracker_move import STILL, UNPUSHED, TrackerMove
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import Vector3

Array = NDArray[np.float64]

# Theatre time for which a guide may approach an unseen head. The approach to a target takes some 5 s.
MOST_UNSEEN_S = 10.0


@dataclass(frozen=True)
class RoomLook:
    """Result of a room check: displacements of head and base, None where not seen.

    `moved` is the error that names what has moved, or what hides it; `findings` stop nothing. `by_frame` says
    that the head is compared by the frame on its clamp, as the spheres are hidden.
    """

    reading: RoomReading
    head_mm: float | None
    base: BaseShift | None
    findings: tuple[str, ...] = ()
    moved: RoomMoved | RoomUndecided | PatientUnseen | None = None
    by_frame: bool = False

    @property
    def in_place(self) -> bool:
        """Whether head and base were seen and unmoved. The tracker may have moved slightly."""
        return self.moved is None and self.head_mm is not None and self.base is not None

    def require(self) -> tuple[str, ...]:
        """Return the findings. Raises `moved` if set.

        Raises PRO-019 if cart or tracker was moved, PRO-020 if the head has, PRO-022 if a sphere near the
        head is at no known position, PRO-051 if the patient's frame has slipped on the clamp, PRO-052 if the
        arm's pose does not tell whether head or tracker was moved.
        """
        if self.moved is not None:
            raise self.moved
        return self.findings


@dataclass
class Approach:
    """Guide approach to the head. `excused_s` is when the operator last continued without line of sight.

    The time without sight is bounded only while it is under way: nothing holds up the way out.
    """

    arm_hides_head: Callable[[], bool]
    under_way: bool = False
    excused_s: float = -math.inf


@dataclass
class RoomWatch:
    """Watch over the spheres and frames of one global localization, with all later readings.

    There is one tracker frame, that of the localization: all places are in it, and every tracker frame read
    later is expressed in it first (`as_localized`). With the patient's frame (`on_clamp`) a pushed tracker is
    followed; `tracker_moved` is told.
    """

    localization: str  # identifier of the record
    robot_from_tracker: Transform
    spheres_mm: Array  # (n, 3) on the head, tracker frame
    references: list[RoomReading] = field(default_factory=list)
    seen_s: float = 0.0  # theatre time at which the head was last seen in its place
    approach: Approach | None = None
    on_clamp: FrameOnClamp | None = None
    tracker: TrackerMove = UNPUSHED  # since the localization
    tracker_moved: Callable[[TrackerMove], None] = lambda _move: None

    def __post_init__(self) -> None:
        self._localized = self.spheres_mm, self.on_clamp
        self._by_frame_only = False  # as told last
        self._before_push = 0  # references from before the last followed push

    def follow(self, spheres_mm: Array | None, on_clamp: Transform | None = None) -> None:
        """Set the expected sphere positions (n, 3), or restore the localized ones with None.

        With the spheres, the pose of the patient's frame is set: without one, as while it was hidden when
        they were measured, nothing stands in for them.
        """
        expected_mm, clamp = self._localized
        if spheres_mm is not None:
            expected_mm = spheres_mm
            clamp = None if clamp is None or on_clamp is None else FrameOnClamp(on_clamp, clamp.markers_mm)
        if not np.array_equal(expected_mm, self.spheres_mm):  # the same array is the same watch
            self.spheres_mm, self.on_clamp = expected_mm, clamp

    def as_localized(self, frame: TrackerFrame) -> TrackerFrame:
        """Return a tracker frame as the tracker would have seen it from where it was at the localization."""
        return frame if self.tracker.move is STILL else seen_after(self.tracker.move.inverse(), frame)

    def read(self, workcell: Workcell, frames: list[TrackerFrame]) -> RoomReading:
        """Average tracker frames taken at the arm's current pose into a reading for `compare`."""
        localized = [self.as_localized(frame) for frame in frames]
        return room_reading(workcell, localized, self.robot_from_tracker)

    @property
    def sights(self) -> tuple[TrackerSight, ...]:
        """Sight of the tracker, from where it is now, on the spheres and on the frame on the clamp."""
        move = self.tracker.move
        here = self.robot_from_tracker @ move.inverse()
        places = (self.spheres_mm, *(() if self.on_clamp is None else (self.on_clamp.places_mm,)))
        return tuple(TrackerSight(here, move.apply(one)) for one in places)

    def add_reference(self, frame_mm: Array | None) -> None:
        """Add the frame position (3,) seen before a restart, with the arm home and all joints settled."""
        home = self.references[0].robot_from_flange
        if frame_mm is not None:
            nothing = np.empty((0, 3))
            self.references.append(RoomReading(home, frame_mm, nothing, frames=CAREFUL_FRAMES, settled=True))
        if self.tracker.move is not STILL:
            self._before_push = len(self.references)

    def unseen_s(self, now_s: float) -> float:
        """Return the theatre time since the head was seen or the operator continued without sight."""
        excused_s = -math.inf if self.approach is None else self.approach.excused_s
        return now_s - max(self.seen_s, excused_s)

    def excuse(self) -> None:
        """Continue without line of sight. The unseen time restarts with the next motion or wait."""
        if self.approach is not None:
            self.approach.excused_s = math.inf

    def begin_motion(self, now_s: float) -> None:
        """Record the start of a motion or wait."""
        if self.approach is not None:
            self.approach.excused_s = min(self.approach.excused_s, now_s)

    def is_overdue(self, now_s: float) -> bool:
        """Return whether a guide is approaching a head that has been unseen for too long."""
        return self.is_approached and self.unseen_s(now_s) > MOST_UNSEEN_S

    @property
    def is_approached(self) -> bool:
        """Whether a guide is approaching the head or is in position in front of it."""
        return self.approach is not None and self.approach.under_way

    @property
    def arm_hides_head(self) -> bool:
        """Whether the arm's present pose is expected to hide the head from the tracker."""
        return self.approach is not None and self.approach.arm_hides_head()

    def compare(self, reading: RoomReading, now_s: float = 0.0) -> RoomLook:
        """Compare a reading with earlier ones, and store it as a reference if nothing has moved."""
        reading, findings = self.follow_tracker(reading)
        motion = self._motion(reading)
        head, base, moved = motion.head, motion.base, motion.moved
        if isinstance(moved, BaseShifted) and moved.cart:
            moved.room_moved = motion.room_moved
        by_frame = motion.by_spheres is None and head is not None
        if moved is None:
            if head is not None and base is not None and head.rms_mm >= reading.head_limit_mm:
                findings += (f"the tracker was moved by {describe_way(base.way_mm)}; arm and head agree",)
                crept = Transform.of(Frame.TRACKER, Frame.TRACKER, translation_mm=head.mean_mm)
                self.tracker = self.tracker.then(crept)
                self.references, self._before_push = [], 0  # both are compared from here on
                reading = reading.moved_by(crept.inverse(), self.robot_from_tracker)
            findings += self._tell_by_frame(hidden=by_frame)
            if reading.frame_mm is not None:
                self.references.append(reading)
            if head is not None:
                self.seen_s = now_s
        return RoomLook(reading, None if head is None else head.rms_mm, base, findings, moved, by_frame)

    def _motion(self, reading: RoomReading) -> RoomMotion:
        return RoomMotion(
            reading,
            self.robot_from_tracker,
            self.spheres_mm,
            self.on_clamp,
            self.tracker.move.inverse().apply(SENSORS_MM),
            self.base_shift(reading) or gross_shift(self.references, reading),
            nearest_shift(self.references, reading),
            base_turn_rad(self.references, reading),
        )

    def follow_tracker(self, reading: RoomReading) -> tuple[RoomReading, tuple[str, ...]]:
        """If only the tracker was moved, follow it.

        Only a careful reading in the very pose of an earlier one decides. Return the reading as seen from
        where the tracker was, and the finding.
        """
        motion = self._motion(reading)
        base, head = motion.base, motion.head_move
        if head is None or base is None or not (base.exact and reading.is_careful):
            return reading, ()
        arm = motion.arm_frame(base)
        push = None if arm is None else head.as_push(arm)
        if arm is None or push is None:
            return reading, ()
        unnoticed_mm = head.unnoticed_mm + base.backlash_mm
        self.tracker = self.tracker.then(push, unnoticed_mm / math.sqrt(3.0))
        self.tracker_moved(self.tracker)
        self._before_push = len(self.references)
        at_head_mm = PointShift.of(push.apply(self.spheres_mm) - self.spheres_mm).rms_mm
        turned_deg = math.degrees(float(push.rigid.rotation.magnitude()))
        return reading.moved_by(push.inverse(), self.robot_from_tracker), (
            f"the tracker was moved: by {at_head_mm:.1f} mm as seen at the head, turned by {turned_deg:.2f} "
            f"deg; the frames on head clamp and arm agree within {arm.off_mm(head.move):.2f} mm, and the "
            f"case goes on; the head may have moved by up to {unnoticed_mm:.2f} mm meanwhile",
        )

    def is_clamp_away(self, reading: RoomReading) -> bool:
        """Return whether the patient's frame is seen out of its place."""
        shift = self._motion(reading).by_frame
        return shift is not None and shift.rms_mm >= reading.head_limit_mm

    def _tell_by_frame(self, *, hidden: bool) -> tuple[str, ...]:
        """Return a finding when the spheres have become hidden and only the frame on the clamp is watched."""
        is_new = hidden and not self._by_frame_only
        self._by_frame_only = hidden
        if not is_new:
            return ()
        return ("the spheres on the head are hidden: the frame on its clamp is watched in their place",)

    def base_shift(self, reading: RoomReading) -> BaseShift | None:
        """Return a shift over its limit, else the most tightly limited one, or None without a reference."""
        return base_shift(self.references, reading, self._before_push)

    def frame_off_arm_mm(self, seen_mm: Vector3, begin_mm: Vector3, end_mm: Vector3) -> float | None:
        """Return the distance of the frame on a moving arm from the arm's way, or None within the limit.

        `seen_mm` is its position in one tracker frame, tracker frame. The arm had it at `begin_mm` before
        that frame and at `end_mm` after it, robot frame. The limit grows by the way between: the arm may
        report late.
        """
        way_mm = np.subtract(end_mm, begin_mm)
        gone_mm = self.robot_from_tracker.apply(seen_mm) - begin_mm
        length_mm = math.hypot(*way_mm)
        share = float(gone_mm @ way_mm) / length_mm**2 if length_mm > 0.0 else 0.0
        off_mm = math.hypot(*(gone_mm - min(1.0, max(0.0, share)) * way_mm))
        return off_mm if off_mm > GROSS_LIMIT_MM + length_mm else None


def read_watched(room: RoomWatch, workcell: Workcell, clock: Clock, count: int = FRAMES) -> RoomReading:
    """Read the room with the arm at rest; carefully, if the frame on the clamp is out of its place."""
    reading = room.read(workcell, read_frames_at_rest(workcell.tracker, clock, count=count)[0])
    if reading.is_careful or not room.is_clamp_away(reading):
        return reading
    return room.read(workcell, read_frames_at_rest(workcell.tracker, clock, count=CAREFUL_FRAMES)[0])


def check_now(
    room: RoomWatch,
    workcell: Workcell,
    clock: Clock,
    memory: CaseMemory,
    void: Callable[[RonnaError], None],
    count: int = FRAMES,
) -> RoomLook:
    """Check the room now and raise like `RoomLook.require`. A movement voids results and ends the watch."""
    look = room.compare(read_watched(room, workcell, clock, count), clock.now_s())
    if isinstance(look.moved, RoomMoved):
        void(look.moved)  # first: the watch goes on until this is written
    if isinstance(look.moved, RoomMoved | RoomUndecided):
        memory.drop(RoomWatch)  # the same move must not stop the way out
    look.require()
    return look
