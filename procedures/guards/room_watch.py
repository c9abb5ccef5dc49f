"""Whether anything has moved since the localization, by the frame on the arm and the patient's spheres.

The place of the frame is compared by its difference between tracker and arm. That difference depends on the
arm's orientation by as much as the mount is off its drawing, some millimetres, so it is compared with what it
was in the same orientation before. Every reading is such a reference for those that come later.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from procedures.guards.errors import BaseShifted, PatientMoved, PatientUnseen
from procedures.guards.ghosts import ghosts_of
from procedures.guards.stability import BASE_NOTICEABLE_MM, CAREFUL_FRAMES, HEAD_NOTICEABLE_MM
from procedures.registration.movement import NEAR_MM, PointShift, lone_displacement_mm, shift_of, shift_of_few
from ronna_hw.frames import Transform
from ronna_hw.text import beyond, counted

Array = NDArray[np.float64]

# Half of the 1.7 mm that must be noticed at any rest of the arm. In the same pose the frame is displaced by
# backlash: 0.52 mm at most in 800 simulated pairs that were reached from different sides.
BASE_LIMIT_MM = 0.85
# In another pose of the same orientation arm and tracker err differently: 0.96 mm at most in 360 pairs.
OTHER_POSE_LIMIT_MM = 1.3
# Between the noise, 0.10 mm at most in 600 readings of 12 frames, and the 0.5 mm that must be noticed.
PATIENT_LIMIT_MM = 0.3
FEW_LIMIT_MM = 0.8  # of two spheres, which no rigid fit averages: the tracker's own bias shows in each
NEAR_HEAD_MM = 60.0  # from a known sphere: what reflects there is taken for a sphere of the head
SAME_ORIENTATION_RAD = math.radians(1.0)  # 3.5 mm of the mount make 0.06 mm
FARTHEST_MM = 150.0  # between poses that are compared: the tracker's own bias changes with the place
SAME_POSE_RAD, SAME_POSE_MM = math.radians(0.1), 1.0
# Theatre time that a guide may approach a head that nothing sees. The way onto a target takes some 5 s.
MOST_UNSEEN_S = 10.0


@dataclass(frozen=True)
class RoomReading:
    """One look of the tracker while the arm rests.

    `robot_from_flange` is the arm's pose, by its calibration or else nominal, `frame_mm` (3,) the frame by
    the tracker minus the frame by the arm, robot frame, or None while it is not seen; `spheres_mm` (m, 3) are
    strays and `markers_mm` (k, 3) the markers of the frame and of other tools in view, tracker frame.
    `frames` of the tracker were averaged. `settled` says that every joint came to rest from the same side
    as ever, at home.
    """

    robot_from_flange: Transform
    frame_mm: Array | None
    spheres_mm: Array
    markers_mm: Array = field(default_factory=lambda: np.empty((0, 3)))
    frames: int = 1
    settled: bool = False

    @property
    def careful(self) -> bool:
        """Averaged over enough frames (`CAREFUL_FRAMES`) for a look before or after a target."""
        return self.frames >= CAREFUL_FRAMES

    @property
    def comparable(self) -> bool:
        """Whether a frame on the arm in the same pose may differ by noise only."""
        return self.careful and self.settled

    @property
    def head_limit_mm(self) -> float:
        """Rms of the spheres from which on the head has moved."""
        return HEAD_NOTICEABLE_MM if self.careful else PATIENT_LIMIT_MM


@dataclass(frozen=True)
class BaseShift:
    """Way of the frame on the arm (3,) mm against an earlier reading, and from where on it has moved.

    `exact` says that the arm stands in the very pose of that reading.
    """

    way_mm: Array
    limit_mm: float
    exact: bool

    @property
    def moved_mm(self) -> float:
        """Length of the way."""
        return float(np.linalg.norm(self.way_mm))


@dataclass(frozen=True)
class RoomLook:
    """A reading compared: how far head and base are from their places, None where that was not seen.

    `moved` is what has moved, or what keeps that from being told; `findings` are what stops nothing.
    """

    reading: RoomReading
    head_mm: float | None
    base: BaseShift | None
    findings: tuple[str, ...] = ()
    moved: BaseShifted | PatientMoved | PatientUnseen | None = None

    @property
    def in_place(self) -> bool:
        """Whether head and base were seen, and neither has moved; the tracker may have, by little."""
        return self.moved is None and self.head_mm is not None and self.base is not None


@dataclass
class Approach:
    """A guide on its way to the head, or in it. `excused_s`: when it last went on without sight.

    Only while it is under way the time without sight is bounded: nothing holds up the way out.
    """

    arm_hides_head: Callable[[], bool]
    under_way: bool = False
    excused_s: float = -math.inf


@dataclass
class RoomWatch:
    """What one global localization has found, and the readings since."""

    localization: str  # identifier of the record
    robot_from_tracker: Transform
    spheres_mm: Array  # (n, 3) those on the head, tracker frame
    references: list[RoomReading] = field(default_factory=list)
    seen_s: float = 0.0  # theatre time at which the head was last seen in its place
    approach: Approach | None = None

    def __post_init__(self) -> None:
        self._localized_mm = self.spheres_mm

    def follow(self, spheres_mm: Array | None) -> None:
        """From here on the spheres are expected there; None where they were localized."""
        wanted = self._localized_mm if spheres_mm is None else spheres_mm
        if not np.array_equal(wanted, self.spheres_mm):
            self.spheres_mm = wanted

    def refer(self, frame_mm: Array | None) -> None:
        """Take in how the frame was seen before a restart, with the arm home and every joint settled."""
        home = self.references[0].robot_from_flange
        if frame_mm is not None:
            nothing = np.empty((0, 3))
            self.references.append(RoomReading(home, frame_mm, nothing, frames=CAREFUL_FRAMES, settled=True))

    def unseen_s(self, now_s: float) -> float:
        """Theatre time since the head was seen, or since the operator went on without."""
        excused_s = -math.inf if self.approach is None else self.approach.excused_s
        return now_s - max(self.seen_s, excused_s)

    def excuse(self) -> None:
        """The operator continues without sight: the time begins again with the next motion or wait."""
        if self.approach is not None:
            self.approach.excused_s = math.inf

    def begin_motion(self, now_s: float) -> None:
        """A motion or a wait begins."""
        if self.approach is not None:
            self.approach.excused_s = min(self.approach.excused_s, now_s)

    def overdue(self, now_s: float) -> bool:
        """Whether a guide approaches a head that was not seen for too long."""
        return self.approached and self.unseen_s(now_s) > MOST_UNSEEN_S

    @property
    def approached(self) -> bool:
        """Whether a guide approaches the head or is held in front of it."""
        return self.approach is not None and self.approach.under_way

    @property
    def arm_hides_head(self) -> bool:
        """Whether the arm is expected to hide the head in its present pose."""
        return self.approach is not None and self.approach.arm_hides_head()

    def compare(self, reading: RoomReading, now_s: float = 0.0) -> RoomLook:
        """Compare a reading with those before and keep it unless something has moved."""
        head, base = shift_of(self.spheres_mm, reading.spheres_mm), self.base_shift(reading)
        head_mm = None if head is None else head.rms_mm
        try:
            return RoomLook(reading, head_mm, base, tuple(self.check(reading, now_s)))
        except (BaseShifted, PatientMoved, PatientUnseen) as moved:
            return RoomLook(reading, head_mm, base, moved=moved)

    def check(self, reading: RoomReading, now_s: float = 0.0) -> list[str]:
        """Compare a reading with those before and keep it; returns findings, in words.

        Raises PRO-019 when cart or tracker was moved, PRO-020 when the head has, PRO-022 when a sphere near
        it is in no known place.
        """
        findings: list[str] = []
        base = self.base_shift(reading)
        head = shift_of(self.spheres_mm, reading.spheres_mm)
        head_mm = None if head is None else self.robot_from_tracker.rotation_matrix @ head.mean_mm
        apart_mm = math.inf
        if head is not None and head_mm is not None and base is not None:
            apart_mm = _apart_from_base_mm(head, head_mm, base.way_mm)
        tracker_alone = apart_mm < reading.head_limit_mm  # arm and head agree
        if base is not None and base.moved_mm >= (BASE_LIMIT_MM if tracker_alone else base.limit_mm):
            raise _base_shifted(base, head_mm)
        few = None if head is not None else shift_of_few(self.spheres_mm, reading.spheres_mm)
        if few is not None and few.rms_mm >= FEW_LIMIT_MM:
            few_mm = self.robot_from_tracker.rotation_matrix @ few.mean_mm
            raise _patient_moved(few, few_mm, FEW_LIMIT_MM, tracker_excluded=base is not None)
        if head is None and (strange := self._strange(reading)):
            raise PatientUnseen(
                f"the tracker sees {counted(strange, 'sphere')} near the head at no known position",
                expected="at least three known spheres in place",
            )
        limit_mm = reading.head_limit_mm
        if head is not None and head_mm is not None and head.rms_mm >= limit_mm:
            same = base is not None and base.exact
            if base is None or not same or not tracker_alone:
                apart = base is not None and (same or float(np.linalg.norm(head_mm)) >= base.limit_mm)
                alone_mm = lone_displacement_mm(self.spheres_mm, reading.spheres_mm, limit_mm)
                if alone_mm is not None:
                    raise _screw_moved(head, alone_mm, limit_mm)
                raise _patient_moved(head, head_mm, limit_mm, tracker_excluded=apart)
            findings.append(f"the tracker was moved by {_in_words(base.way_mm)}; arm and head agree")
            self._localized_mm = self._localized_mm + head.mean_mm  # both are compared from here on
            self.spheres_mm, self.references = self.spheres_mm + head.mean_mm, []
        if reading.frame_mm is not None:
            self.references.append(reading)
        if head is not None:
            self.seen_s = now_s
        return findings

    def base_shift(self, reading: RoomReading) -> BaseShift | None:
        """The shift beyond its limit, or else that with the narrowest; None where nothing can be compared."""
        if reading.frame_mm is None:
            return None
        shifts = [
            BaseShift(reading.frame_mm - one.frame_mm, limit_mm, exact)
            for one, limit_mm, exact in self._references(reading)
            if one.frame_mm is not None
        ]
        return min(shifts, key=lambda shift: (shift.moved_mm < shift.limit_mm, shift.limit_mm), default=None)

    def _strange(self, reading: RoomReading) -> int:
        """How many points near the head are in no known place: it may have moved, and the rest be hidden.

        Where lines to markers in known places cross, nothing need be.
        """
        if not len(reading.spheres_mm):
            return 0
        apart = np.linalg.norm(reading.spheres_mm[:, None] - self.spheres_mm[None], axis=2).min(axis=1)
        ghosts = (apart >= NEAR_MM) & ghosts_of(self.spheres_mm, reading.markers_mm, reading.spheres_mm)
        return int(((apart >= FEW_LIMIT_MM) & (apart < NEAR_HEAD_MM) & ~ghosts).sum())

    def _references(self, reading: RoomReading) -> list[tuple[RoomReading, float, bool]]:
        """Earlier readings to compare with, the limit that each is held to, and whether the pose is the same.

        Of the same pose the oldest, so that a slow drift adds up, and the oldest of those that may differ by
        noise only; else the nearest of the same orientation, the newest of those equally near.
        """
        here = reading.robot_from_flange
        alike = [
            (apart_mm, -number, one)
            for number, one in enumerate(self.references)
            if _turned_rad(one.robot_from_flange, here) <= SAME_ORIENTATION_RAD
            and (apart_mm := _apart_mm(one.robot_from_flange, here)) <= FARTHEST_MM
        ]
        exact = [one for one in self.references if _same_pose(one.robot_from_flange, here)]
        if not exact:
            return [(min(alike)[2], OTHER_POSE_LIMIT_MM, False)] if alike else []
        settled = [one for one in exact if one.comparable] if reading.comparable else []
        return [(exact[0], BASE_LIMIT_MM, True), *((one, BASE_NOTICEABLE_MM, True) for one in settled[:1])]


def _same_pose(one: Transform, other: Transform) -> bool:
    return _turned_rad(one, other) < SAME_POSE_RAD and _apart_mm(one, other) < SAME_POSE_MM


def _apart_mm(one: Transform, other: Transform) -> float:
    return math.dist(one.translation_mm, other.translation_mm)


def _turned_rad(one: Transform, other: Transform) -> float:
    between = one.rotation_matrix.T @ other.rotation_matrix
    return math.acos(min(1.0, max(-1.0, (float(np.trace(between)) - 1.0) / 2.0)))


def _apart_from_base_mm(head: PointShift, head_mm: Array, base_mm: Array) -> float:
    """RMS by which the spheres moved otherwise than the frame; a turn leaves their mean where it was."""
    turned_mm2 = max(0.0, head.rms_mm**2 - float(head.mean_mm @ head.mean_mm))
    return math.sqrt(turned_mm2 + float(np.sum((head_mm - base_mm) ** 2)))


def _base_shifted(base: BaseShift, head_mm: Array | None) -> BaseShifted:
    # The frame moves with the cart, and against the tracker; the head only against the tracker.
    apart_mm = math.inf if head_mm is None else float(np.linalg.norm(head_mm - base.way_mm))
    tracker = apart_mm < min(BASE_LIMIT_MM, base.moved_mm) / 2.0
    way_mm = -base.way_mm if tracker else base.way_mm
    shifted = BaseShifted(
        f"{'the tracker' if tracker else 'the cart of the robot'} was moved by {_in_words(way_mm)}",
        limit=f"{base.limit_mm:g} mm",
        got=f"{beyond(base.moved_mm, base.limit_mm, 2)} mm",
    )
    shifted.cart = not tracker
    return shifted


def _patient_moved(
    head: PointShift, head_mm: Array, limit_mm: float, *, tracker_excluded: bool
) -> PatientMoved:
    # Where the frame on the arm cannot be compared, a tracker that was moved looks the same.
    what = "the head" if tracker_excluded else "the head, or the tracker,"
    return PatientMoved.by(
        f"{what} has moved since it was localized, by {_in_words(head_mm)}, the mean of "
        f"{head.points} spheres",
        head.rms_mm,
        limit_mm,
    )


def _screw_moved(head: PointShift, alone_mm: float, limit_mm: float) -> PatientMoved:
    return PatientMoved.by(
        f"one sphere has moved by {alone_mm:.1f} mm since it was localized and the other {head.points - 1} "
        "have not: its screw may be loose",
        head.rms_mm,
        limit_mm,
    )


def _in_words(way_mm: Array) -> str:
    x, y, z = way_mm.tolist()
    return f"{np.linalg.norm(way_mm):.2f} mm (x {x:+.2f}, y {y:+.2f}, z {z:+.2f} in the robot frame)"
