"""Detection of movement since the localization, from the frame on the arm and the patient's spheres.

The frame on the arm is compared by the difference of its places according to tracker and arm. As the mount is
some millimetres off its drawing, this difference depends on the arm's orientation, so it is compared with
earlier readings in the same orientation. Every reading becomes such a reference.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from procedures.engine.setting import CaseMemory
from procedures.guards.clamp_frame import (
    PUSH_AGREES_MM,
    PUSH_AGREES_SHORTLY_MM,
    FrameOnClamp,
    find_push,
)
from procedures.guards.errors import BaseShifted, FrameSlipped, PatientMoved, PatientUnseen, RoomMoved
from procedures.guards.room_reading import FRAMES, RoomReading, find_ghosts, read_room
from procedures.guards.stability import BASE_NOTICEABLE_MM, CAREFUL_FRAMES
from procedures.registration.movement import (
    NEAR_MM,
    PointShift,
    lone_displacement_mm,
    measure_shift,
    measure_shift_of_few,
)
from procedures.workcell import Workcell
from ronna_hw.clock import Clock
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit, format_count

Array = NDArray[np.float64]

# Half of the 1.7 mm that must be noticed at any rest of the arm. In one pose, reached from different sides,
# backlash displaces the frame by 0.52 mm at most in 800 simulated pairs.
BASE_LIMIT_MM = 0.85
# In another pose of the same orientation arm and tracker err differently: 0.96 mm at most in 360 pairs.
OTHER_POSE_LIMIT_MM = 1.3
FEW_LIMIT_MM = 0.8  # of two spheres, not averaged by a rigid fit: the tracker's bias shows in each
NEAR_HEAD_MM = 60.0  # from a known sphere: anything that reflects there is taken for a sphere of the head
SAME_ORIENTATION_RAD = math.radians(1.0)  # 3.5 mm of the mount make 0.06 mm
FARTHEST_MM = 150.0  # between poses that are compared: the tracker's bias changes with the place
SAME_POSE_RAD, SAME_POSE_MM = math.radians(0.1), 1.0
# Theatre time for which a guide may approach an unseen head. The approach to a target takes some 5 s.
MOST_UNSEEN_S = 10.0


@dataclass(frozen=True)
class BaseShift:
    """Displacement (3,) mm of the frame on the arm since an earlier reading, and its limit.

    `exact` says that the arm is in the very pose of that reading.
    """

    way_mm: Array
    limit_mm: float
    exact: bool

    @property
    def moved_mm(self) -> float:
        """Magnitude of the displacement."""
        return float(np.linalg.norm(self.way_mm))


@dataclass(frozen=True)
class RoomLook:
    """Result of a room check: displacements of head and base, None where not seen.

    `moved` is the error that names what has moved, or what hides it; `findings` stop nothing.
    """

    reading: RoomReading
    head_mm: float | None
    base: BaseShift | None
    findings: tuple[str, ...] = ()
    moved: RoomMoved | PatientUnseen | None = None

    @property
    def in_place(self) -> bool:
        """Whether head and base were seen and unmoved. The tracker may have moved slightly."""
        return self.moved is None and self.head_mm is not None and self.base is not None

    def require(self) -> tuple[str, ...]:
        """Return the findings. Raises `moved` if set.

        Raises PRO-019 if cart or tracker was moved, PRO-020 if the head has, PRO-022 if a sphere near the
        head is at no known position, PRO-051 if the patient's frame has slipped on the clamp.
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

    With the patient's frame (`on_clamp`) a pushed tracker is followed: `tracker_move` is TRACKER now <-
    TRACKER at the localization.
    """

    localization: str  # identifier of the record
    robot_from_tracker: Transform
    spheres_mm: Array  # (n, 3) on the head, tracker frame
    references: list[RoomReading] = field(default_factory=list)
    seen_s: float = 0.0  # theatre time at which the head was last seen in its place
    approach: Approach | None = None
    on_clamp: FrameOnClamp | None = None
    tracker_move: Transform = field(default_factory=lambda: Transform.of(Frame.TRACKER, Frame.TRACKER))

    def __post_init__(self) -> None:
        self._localized_mm, self._localized_clamp = self.spheres_mm, self.on_clamp
        self._by_frame_only = False  # as told last

    def follow(self, spheres_mm: Array | None, on_clamp: Transform | None = None) -> None:
        """Set the expected sphere positions (n, 3), or restore the localized ones with None.

        They, and the pose of the patient's frame, are as seen from where the tracker was at the localization.
        """
        expected_mm, clamp = self._localized_mm, self._localized_clamp
        if spheres_mm is not None:
            expected_mm = spheres_mm if clamp is None else self.tracker_move.apply(spheres_mm)
            if clamp is not None and on_clamp is not None:
                clamp = replace(clamp, pose=self.tracker_move @ on_clamp)
        self.on_clamp = clamp
        if not np.array_equal(expected_mm, self.spheres_mm):
            self.spheres_mm = expected_mm

    def add_reference(self, frame_mm: Array | None) -> None:
        """Add the frame position (3,) seen before a restart, with the arm home and all joints settled."""
        home = self.references[0].robot_from_flange
        if frame_mm is not None:
            nothing = np.empty((0, 3))
            self.references.append(RoomReading(home, frame_mm, nothing, frames=CAREFUL_FRAMES, settled=True))

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
        base, by_spheres = self.base_shift(reading), measure_shift(self.spheres_mm, reading.spheres_mm)
        head = self._shift_by_frame(reading) if by_spheres is None else by_spheres
        head_mm = None if head is None else self.robot_from_tracker.rotation_matrix @ head.mean_mm
        agree = _moved_alike(head, head_mm, base, reading.head_limit_mm)
        moved = self._find_motion(reading, base, head, head_mm, by_spheres, agree=agree)
        if moved is None:
            if head is not None and base is not None and head.rms_mm >= reading.head_limit_mm:
                findings += (f"the tracker was moved by {_describe_way(base.way_mm)}; arm and head agree",)
                self._localized_mm = self._localized_mm + head.mean_mm  # both are compared from here on
                self.spheres_mm, self.references = self.spheres_mm + head.mean_mm, []
                self._move_clamp(Transform.of(Frame.TRACKER, Frame.TRACKER, translation_mm=head.mean_mm))
            findings += self._tell_by_frame(hidden=by_spheres is None and head is not None)
            if reading.frame_mm is not None:
                self.references.append(reading)
            if head is not None:
                self.seen_s = now_s
        return RoomLook(reading, None if head is None else head.rms_mm, base, findings, moved)

    def _find_motion(
        self,
        reading: RoomReading,
        base: BaseShift | None,
        head: PointShift | None,
        head_mm: Array | None,
        by_spheres: PointShift | None,
        *,
        agree: bool,
    ) -> RoomMoved | PatientUnseen | None:
        """Return the error for a movement or for hidden spheres, or None if nothing has moved.

        `head` is by the spheres or, while those are hidden, by the patient's frame; `head_mm` (3,) is its
        displacement in the robot frame. If arm and head `agree`, only the tracker has moved.
        """
        if base is not None and base.moved_mm >= (BASE_LIMIT_MM if agree else base.limit_mm):
            return _base_shifted(base, head_mm)
        if by_spheres is None:
            few = self._find_motion_by_few(reading, tracker_excluded=base is not None)
            if few is not None:
                return few
        if head is None or head_mm is None:
            return None
        limit_mm = reading.head_limit_mm
        if (
            by_spheres is not None
            and (parted := self._find_parting(reading, by_spheres, head_mm)) is not None
        ):
            return parted
        if head.rms_mm < limit_mm or (base is not None and base.exact and agree):
            return None
        alone_mm = lone_displacement_mm(self.spheres_mm, reading.spheres_mm, limit_mm)
        if alone_mm is not None:
            return _screw_moved(head, alone_mm, limit_mm)
        apart = base is not None and (base.exact or float(np.linalg.norm(head_mm)) >= base.limit_mm)
        if by_spheres is None:
            return _clamp_moved(head, head_mm, limit_mm, tracker_excluded=apart)
        return _patient_moved(head, head_mm, limit_mm, tracker_excluded=apart)

    def _find_parting(
        self, reading: RoomReading, head: PointShift, head_mm: Array
    ) -> FrameSlipped | PatientMoved | None:
        """Return the error for a frame that slipped on the clamp, or a head that slipped in it, or None."""
        if self.on_clamp is None or reading.on_clamp is None:
            return None
        limit_mm = reading.head_limit_mm
        apart_mm = self.on_clamp.apart_mm(reading.on_clamp, head)
        if apart_mm < limit_mm:
            return None
        if head.rms_mm >= limit_mm:
            if self.on_clamp.shift(reading.on_clamp).rms_mm >= limit_mm:
                return None  # both have moved, perhaps with the tracker
            if lone_displacement_mm(self.spheres_mm, reading.spheres_mm, limit_mm) is not None:
                return None  # told by its own name
            return PatientMoved.from_shift(
                f"the head has moved in its clamp since it was localized, by {_describe_way(head_mm)}: the "
                "frame on the clamp is in its place",
                head.rms_mm,
                limit_mm,
            )
        return FrameSlipped(
            "the patient's frame has moved on the head clamp since the localization, against the spheres",
            limit=f"{limit_mm:g} mm",
            got=f"{format_against_limit(apart_mm, limit_mm, 2)} mm rms",
        )

    def follow_tracker(self, reading: RoomReading) -> tuple[RoomReading, tuple[str, ...]]:
        """If only the tracker was moved, move with it.

        Return the reading as seen from its new place, and the finding.
        """
        base = self.base_shift(reading)
        if self.on_clamp is None or reading.on_clamp is None or base is None or reading.arm_frame_mm is None:
            return reading, ()
        before = self.robot_from_tracker
        way_mm = before.rotation_matrix.T @ base.way_mm
        arm_mm = (reading.arm_frame_mm - way_mm, reading.arm_frame_mm)
        move = find_push(
            self.on_clamp,
            reading.on_clamp,
            self.spheres_mm,
            reading.spheres_mm,
            arm_mm,
            (
                reading.head_limit_mm,
                PUSH_AGREES_MM if reading.is_careful else PUSH_AGREES_SHORTLY_MM,
            ),
        )
        if move is None:
            return reading, ()
        self.robot_from_tracker = before @ move.inverse()
        self._localized_mm, self.spheres_mm = move.apply(self._localized_mm), move.apply(self.spheres_mm)
        self._move_clamp(move)
        at_head_mm = PointShift.of(self.spheres_mm - move.inverse().apply(self.spheres_mm)).rms_mm
        turned_deg = math.degrees(float(move.rigid.rotation.magnitude()))
        return reading.seen_by_moved(before, self.robot_from_tracker), (
            f"the tracker was moved: by {at_head_mm:.1f} mm as seen at the head, turned by {turned_deg:.2f} "
            "deg; the frames on head clamp and arm agree, and the case goes on",
        )

    def _move_clamp(self, move: Transform) -> None:
        if self.on_clamp is not None and self._localized_clamp is not None:
            self.on_clamp = self.on_clamp.moved_by(move)
            self._localized_clamp = self._localized_clamp.moved_by(move)
            self.tracker_move = move @ self.tracker_move

    def is_clamp_away(self, reading: RoomReading) -> bool:
        """Return whether the patient's frame is seen out of its place."""
        shift = self._shift_by_frame(reading)
        return shift is not None and shift.rms_mm >= reading.head_limit_mm

    def _shift_by_frame(self, reading: RoomReading) -> PointShift | None:
        """Return the shift of the head by the patient's frame alone, or None if that is not seen."""
        if self.on_clamp is None or reading.on_clamp is None:
            return None
        return self.on_clamp.shift(reading.on_clamp)

    def _tell_by_frame(self, *, hidden: bool) -> tuple[str, ...]:
        """Return a finding when the spheres have become hidden and only the frame on the clamp is watched."""
        is_new = hidden and not self._by_frame_only
        self._by_frame_only = hidden
        if not is_new:
            return ()
        return ("the spheres on the head are hidden: the frame on its clamp is watched in their place",)

    def _find_motion_by_few(
        self, reading: RoomReading, *, tracker_excluded: bool
    ) -> PatientMoved | PatientUnseen | None:
        """Return the error found from fewer than three known spheres, or None if none has moved."""
        few = measure_shift_of_few(self.spheres_mm, reading.spheres_mm)
        if few is not None and few.rms_mm >= FEW_LIMIT_MM:
            few_mm = self.robot_from_tracker.rotation_matrix @ few.mean_mm
            return _patient_moved(few, few_mm, FEW_LIMIT_MM, tracker_excluded=tracker_excluded)
        if unknown_count := self._count_unknown(reading):
            return PatientUnseen(
                f"the tracker sees {format_count(unknown_count, 'sphere')} near the head"
                " at no known position",
                expected="at least three known spheres in place",
            )
        return None

    def base_shift(self, reading: RoomReading) -> BaseShift | None:
        """Return a shift over its limit, else the most tightly limited one, or None without a reference."""
        if reading.frame_mm is None:
            return None
        shifts = [
            BaseShift(reading.frame_mm - one.frame_mm, limit_mm, exact)
            for one, limit_mm, exact in self._references(reading)
            if one.frame_mm is not None
        ]
        return min(shifts, key=lambda shift: (shift.moved_mm < shift.limit_mm, shift.limit_mm), default=None)

    def _count_unknown(self, reading: RoomReading) -> int:
        """Count points near the head at no known position, which may be displaced spheres.

        Ghosts do not count.
        """
        if not len(reading.spheres_mm):
            return 0
        apart = np.linalg.norm(reading.spheres_mm[:, None] - self.spheres_mm[None], axis=2).min(axis=1)
        ghosts = (apart >= NEAR_MM) & find_ghosts(self.spheres_mm, reading.markers_mm, reading.spheres_mm)
        return int(((apart >= FEW_LIMIT_MM) & (apart < NEAR_HEAD_MM) & ~ghosts).sum())

    def _references(self, reading: RoomReading) -> list[tuple[RoomReading, float, bool]]:
        """Return comparable earlier readings as (reading, limit in mm, whether the pose is the same).

        In the same pose: the oldest, so that a slow drift adds up, and the oldest that may differ by noise
        only. Otherwise the nearest in the same orientation, and the newest of those equally near.
        """
        here = reading.robot_from_flange
        alike = [
            (apart_mm, -number, one)
            for number, one in enumerate(self.references)
            if _angle_between_rad(one.robot_from_flange, here) <= SAME_ORIENTATION_RAD
            and (apart_mm := _distance_mm(one.robot_from_flange, here)) <= FARTHEST_MM
        ]
        exact = [one for one in self.references if _same_pose(one.robot_from_flange, here)]
        if not exact:
            return [(min(alike)[2], OTHER_POSE_LIMIT_MM, False)] if alike else []
        settled = [one for one in exact if one.is_comparable] if reading.is_comparable else []
        return [(exact[0], BASE_LIMIT_MM, True), *((one, BASE_NOTICEABLE_MM, True) for one in settled[:1])]


def read_watched(room: RoomWatch, workcell: Workcell, clock: Clock, count: int = FRAMES) -> RoomReading:
    """Read the room with the arm at rest; carefully, if the frame on the clamp is out of its place."""
    reading = read_room(workcell, clock, room.robot_from_tracker, count)
    if reading.is_careful or not room.is_clamp_away(reading):
        return reading
    return read_room(workcell, clock, room.robot_from_tracker, CAREFUL_FRAMES)


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
        memory.drop(RoomWatch)  # the same move must not stop the way out
    look.require()
    return look


def _same_pose(one: Transform, other: Transform) -> bool:
    return _angle_between_rad(one, other) < SAME_POSE_RAD and _distance_mm(one, other) < SAME_POSE_MM


def _distance_mm(one: Transform, other: Transform) -> float:
    return math.dist(one.translation_mm, other.translation_mm)


def _angle_between_rad(one: Transform, other: Transform) -> float:
    between = one.rotation_matrix.T @ other.rotation_matrix
    return math.acos(min(1.0, max(-1.0, (float(np.trace(between)) - 1.0) / 2.0)))


def _moved_alike(
    head: PointShift | None, head_mm: Array | None, base: BaseShift | None, limit_mm: float
) -> bool:
    """Return whether spheres and frame moved alike, within an rms limit that includes rotation."""
    if head is None or head_mm is None or base is None:
        return False
    turned_mm2 = max(0.0, head.rms_mm**2 - float(head.mean_mm @ head.mean_mm))
    return math.sqrt(turned_mm2 + float(np.sum((head_mm - base.way_mm) ** 2))) < limit_mm


def _base_shifted(base: BaseShift, head_mm: Array | None) -> BaseShifted:
    # A moved cart displaces the frame alone; a moved tracker displaces frame and head alike.
    apart_mm = math.inf if head_mm is None else float(np.linalg.norm(head_mm - base.way_mm))
    tracker = apart_mm < min(BASE_LIMIT_MM, base.moved_mm) / 2.0
    way_mm = -base.way_mm if tracker else base.way_mm
    shifted = BaseShifted(
        f"{'the tracker' if tracker else 'the cart of the robot'} was moved by {_describe_way(way_mm)}",
        limit=f"{base.limit_mm:g} mm",
        got=f"{format_against_limit(base.moved_mm, base.limit_mm, 2)} mm",
    )
    shifted.cart = not tracker
    return shifted


def _patient_moved(
    head: PointShift, head_mm: Array, limit_mm: float, *, tracker_excluded: bool
) -> PatientMoved:
    # If the frame on the arm cannot be compared, a moved tracker looks the same.
    what = "the head" if tracker_excluded else "the head, or the tracker,"
    return PatientMoved.from_shift(
        f"{what} has moved since it was localized, by {_describe_way(head_mm)}, the mean of "
        f"{head.points} spheres",
        head.rms_mm,
        limit_mm,
    )


def _clamp_moved(
    head: PointShift, head_mm: Array, limit_mm: float, *, tracker_excluded: bool
) -> PatientMoved:
    what = "the head clamp" if tracker_excluded else "the head clamp, or the tracker,"
    return PatientMoved.from_shift(
        f"{what} has moved since the head was localized, by {_describe_way(head_mm)}: by the "
        "frame on it, as the spheres are hidden",
        head.rms_mm,
        limit_mm,
    )


def _screw_moved(head: PointShift, alone_mm: float, limit_mm: float) -> PatientMoved:
    return PatientMoved.from_shift(
        f"one sphere has moved by {alone_mm:.1f} mm since it was localized and the other {head.points - 1} "
        "have not: its screw may be loose",
        head.rms_mm,
        limit_mm,
    )


def _describe_way(way_mm: Array) -> str:
    x, y, z = way_mm.tolist()
    return f"{np.linalg.norm(way_mm):.2f} mm (x {x:+.2f}, y {y:+.2f}, z {z:+.2f} in the robot frame)"
