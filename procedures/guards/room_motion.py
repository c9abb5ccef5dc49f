"""Classifier of movements in the room, by one reading of spheres, frame on the clamp and frame on the arm."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from procedures.guards.base_shift import BASE_LIMIT_MM, BASE_TURN_LIMIT_RAD, BaseShift
from procedures.guards.clamp_frame import ArmFrameSeen, FrameOnClamp, HeadMove, find_head_move
from procedures.guards.errors import (
    BaseShifted,
    FrameSlipped,
    PatientMoved,
    PatientUnseen,
    RoomMoved,
    RoomUndecided,
)
from procedures.guards.room_reading import RoomReading, find_ghosts
from procedures.registration.movement import (
    NEAR_MM,
    PointShift,
    identify_points,
    lone_displacement_mm,
    measure_shift,
    measure_shift_of_few,
)
from procedures.registration.rigid_fit import as_transform, fit_rigid
from procedures.workcell.tracker_move import STILL
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit, format_count

Array = NDArray[np.float64]

FEW_LIMIT_MM = 0.8  # of two spheres, not averaged by a rigid fit: the tracker's bias shows in each
NEAR_HEAD_MM = 60.0  # from a known sphere: anything that reflects there is taken for a sphere of the head


@dataclass(frozen=True)
class RoomMotion:
    """Motion of the three bodies that the tracker sees: spheres, frame on the clamp, frame on the arm.

    Spheres (n, 3), `on_clamp` and the tracker's `sensors_mm` are as expected in the tracker frame of
    `reading`. `base` is the shift of the frame on the arm that counts, `nearest` the one since the reading in
    the most similar orientation; `base_turn_rad` is its turn in the same pose, None if not comparable.
    """

    reading: RoomReading
    robot_from_tracker: Transform
    spheres_mm: Array
    on_clamp: FrameOnClamp | None
    sensors_mm: Array
    base: BaseShift | None
    nearest: BaseShift | None
    base_turn_rad: float | None = None

    @cached_property
    def by_spheres(self) -> PointShift | None:
        """Shift of the head by at least three spheres, or None while they are hidden."""
        return measure_shift(self.spheres_mm, self.reading.spheres_mm)

    @property
    def head(self) -> PointShift | None:
        """Shift of the head by the spheres or, while those are hidden, by the frame on the clamp."""
        return self.by_frame if self.by_spheres is None else self.by_spheres

    @property
    def head_mm(self) -> Array | None:
        """Displacement (3,) of the head in the robot frame, None if not seen."""
        return None if self.head is None else self.robot_from_tracker.rotation_matrix @ self.head.mean_mm

    @property
    def agree(self) -> bool:
        """Whether head and frame on the arm have moved alike."""
        return moved_alike(self.head, self.head_mm, self.base, self.reading.head_limit_mm)

    @cached_property
    def head_move(self) -> HeadMove | None:
        """Return the move that frame on the clamp and visible spheres share, or None."""
        if self.on_clamp is None or self.reading.on_clamp is None:
            return None
        limit_mm = self.reading.head_limit_mm
        return find_head_move(
            self.on_clamp, self.reading.on_clamp, self.spheres_mm, self.reading.spheres_mm, limit_mm
        )

    @cached_property
    def by_frame(self) -> PointShift | None:
        """Return the shift of the head by the patient's frame alone, or None if that is not seen."""
        if self.on_clamp is None or self.reading.on_clamp is None:
            return None
        return self.on_clamp.shift(self.reading.on_clamp)

    def arm_frame(self, base: BaseShift) -> ArmFrameSeen | None:
        """Return the frame on the arm, expected by that shift and seen; None if it is not seen."""
        if self.reading.arm_frame_mm is None:
            return None
        way_mm = self.robot_from_tracker.rotation_matrix.T @ base.way_mm
        return ArmFrameSeen(self.reading.arm_frame_mm - way_mm, self.reading.arm_frame_mm)

    @property
    def moved(self) -> RoomMoved | RoomUndecided | PatientUnseen | None:
        """Error for a movement or for hidden spheres, or None if nothing has moved.

        If arm and head agree, only the tracker has moved.
        """
        return self._find_undecided() or self._find_motion()

    @property
    def room_moved(self) -> Transform | None:
        """Displacement of head and clamp against a moved cart, robot frame, as far as one look tells."""
        by_frame = self.reading.robot_from_tracker
        if by_frame is None:
            return None
        seen = self._displacement()  # by the tracker, which may have been moved as well
        return by_frame @ seen @ self.robot_from_tracker.inverse()

    def _find_motion(self) -> RoomMoved | PatientUnseen | None:
        """Return the error for a movement, or for hidden spheres, that this pose of the arm can tell."""
        base, head, head_mm, agree = self.base, self.head, self.head_mm, self.agree
        if base is not None and base.moved_mm >= (BASE_LIMIT_MM if agree else base.limit_mm):
            return base_shifted(base, head_mm)
        if self.base_turn_rad is not None and self.base_turn_rad >= BASE_TURN_LIMIT_RAD:
            return base_turned(self.base_turn_rad)
        if self.by_spheres is None:
            few = self._find_motion_by_few(tracker_excluded=base is not None)
            if few is not None:
                return few
        if head is None or head_mm is None:
            return None
        limit_mm = self.reading.head_limit_mm
        if (
            self.by_spheres is not None
            and (parted := self._find_parting(self.by_spheres, head_mm)) is not None
        ):
            return parted
        if head.rms_mm < limit_mm or (base is not None and base.exact and agree):
            return None
        alone_mm = lone_displacement_mm(self.spheres_mm, self.reading.spheres_mm, limit_mm)
        if alone_mm is not None:
            return screw_moved(head, alone_mm, limit_mm)
        apart = base is not None and (base.exact or float(np.linalg.norm(head_mm)) >= base.limit_mm)
        if self.by_spheres is None:
            return clamp_moved(head, head_mm, limit_mm, tracker_excluded=apart)
        return patient_moved(head, head_mm, limit_mm, tracker_excluded=apart)

    def _find_parting(self, head: PointShift, head_mm: Array) -> FrameSlipped | PatientMoved | None:
        """Return the error for a frame that slipped on the clamp, or a head that slipped in it, or None."""
        if self.on_clamp is None or self.reading.on_clamp is None:
            return None
        limit_mm = self.reading.head_limit_mm
        apart_mm = self.on_clamp.apart_mm(self.reading.on_clamp, head)
        if apart_mm < limit_mm:
            return None
        if head.rms_mm >= limit_mm:
            if self.on_clamp.shift(self.reading.on_clamp).rms_mm >= limit_mm:
                return None  # both have moved, perhaps with the tracker
            if lone_displacement_mm(self.spheres_mm, self.reading.spheres_mm, limit_mm) is not None:
                return None  # told by its own name
            return PatientMoved.from_shift(
                f"the head has moved in its clamp since it was localized, by {describe_way(head_mm)}: the "
                "frame on the clamp is in its place",
                head.rms_mm,
                limit_mm,
            )
        return FrameSlipped(
            "the patient's frame has moved on the head clamp since the localization, against the spheres",
            limit=f"{limit_mm:g} mm",
            got=f"{format_against_limit(apart_mm, limit_mm, 2)} mm rms",
        )

    def _find_undecided(self) -> RoomUndecided | None:
        """Return the error for a move of head or tracker that this pose of the arm cannot tell apart."""
        base, head = self.base or self.nearest, self.head_move
        if head is None or (base is not None and base.exact):
            return None
        arm = None if base is None else self.arm_frame(base)
        if base is not None and arm is not None and arm.off_mm(head.move) >= base.limit_mm:
            return None  # not as after a push
        moved_mm = PointShift.of(head.after_mm - head.before_mm).rms_mm
        return RoomUndecided(
            "the tracker, or the head with its clamp, was moved: the frame on the arm tells which of them "
            "only in a pose in which it was seen before, such as home",
            limit=f"{self.reading.head_limit_mm:g} mm",
            got=f"{format_against_limit(moved_mm, self.reading.head_limit_mm, 2)} mm rms",
        )

    def _displacement(self) -> Transform:
        """Return how the tracker sees the head displaced, TRACKER <- TRACKER; as still if it does not."""
        if self.on_clamp is not None and self.reading.on_clamp is not None:
            head = self.head_move
            return STILL if head is None else head.move
        pairs = identify_points(self.spheres_mm, self.reading.spheres_mm)
        if pairs is None:
            return STILL
        rows, columns = (list(side) for side in zip(*pairs, strict=True))
        fit = fit_rigid(self.spheres_mm[rows], self.reading.spheres_mm[columns])
        move = Transform(Frame.TRACKER, Frame.TRACKER, as_transform(fit.rotation, fit.translation_mm))
        shift = PointShift.of(move.apply(self.spheres_mm[rows]) - self.spheres_mm[rows])
        return STILL if shift.rms_mm < self.reading.head_limit_mm else move

    def _find_motion_by_few(self, *, tracker_excluded: bool) -> PatientMoved | PatientUnseen | None:
        """Return the error found from fewer than three known spheres, or None if none has moved."""
        few = measure_shift_of_few(self.spheres_mm, self.reading.spheres_mm)
        if few is not None and few.rms_mm >= FEW_LIMIT_MM:
            few_mm = self.robot_from_tracker.rotation_matrix @ few.mean_mm
            return patient_moved(few, few_mm, FEW_LIMIT_MM, tracker_excluded=tracker_excluded)
        if unknown_count := self._count_unknown():
            return PatientUnseen(
                f"the tracker sees {format_count(unknown_count, 'sphere')} near the head"
                " at no known position",
                expected="at least three known spheres in place",
            )
        return None

    def _count_unknown(self) -> int:
        """Count points near the head at no known position, which may be displaced spheres.

        Ghosts do not count.
        """
        if not len(self.reading.spheres_mm):
            return 0
        apart = np.linalg.norm(self.reading.spheres_mm[:, None] - self.spheres_mm[None], axis=2).min(axis=1)
        ghosts = (apart >= NEAR_MM) & find_ghosts(
            self.spheres_mm, self.reading.markers_mm, self.reading.spheres_mm, self.sensors_mm
        )
        return int(((apart >= FEW_LIMIT_MM) & (apart < NEAR_HEAD_MM) & ~ghosts).sum())


def moved_alike(
    head: PointShift | None, head_mm: Array | None, base: BaseShift | None, limit_mm: float
) -> bool:
    """Return whether spheres and frame moved alike, within an rms limit that includes rotation."""
    if head is None or head_mm is None or base is None:
        return False
    turned_mm2 = max(0.0, head.rms_mm**2 - float(head.mean_mm @ head.mean_mm))
    return math.sqrt(turned_mm2 + float(np.sum((head_mm - base.way_mm) ** 2))) < limit_mm


def base_shifted(base: BaseShift, head_mm: Array | None) -> BaseShifted:
    """Build the error for a moved cart or tracker; `head_mm` (3,) is the head's displacement, if seen."""
    # A moved cart displaces the frame alone; a moved tracker displaces frame and head alike.
    apart_mm = math.inf if head_mm is None else float(np.linalg.norm(head_mm - base.way_mm))
    tracker = apart_mm < min(max(BASE_LIMIT_MM, base.limit_mm), base.moved_mm) / 2.0
    way_mm = -base.way_mm if tracker else base.way_mm
    shifted = BaseShifted(
        # a cart that has also turned was not moved by what its frame shows
        f"{'the tracker was moved' if tracker else 'the cart of the robot was moved, the frame on the arm'} "
        f"by {describe_way(way_mm)}",
        limit=f"{base.limit_mm:g} mm",
        got=f"{format_against_limit(base.moved_mm, base.limit_mm, 2)} mm",
    )
    shifted.cart = not tracker
    return shifted


def patient_moved(
    head: PointShift, head_mm: Array, limit_mm: float, *, tracker_excluded: bool
) -> PatientMoved:
    """Build the error for a head that the spheres show moved."""
    # If the frame on the arm cannot be compared, a moved tracker looks the same.
    what = "the head" if tracker_excluded else "the head, or the tracker,"
    return PatientMoved.from_shift(
        f"{what} has moved since it was localized, by {describe_way(head_mm)}, the mean of "
        f"{head.points} spheres",
        head.rms_mm,
        limit_mm,
    )


def base_turned(turn_rad: float) -> BaseShifted:
    """Build the error for a frame on the arm that is in its place, but turned against the arm."""
    # a turned tracker would displace the head, which is judged by itself
    return BaseShifted(
        f"the cart of the robot, or the frame on the arm, was turned by {math.degrees(turn_rad):.2f} deg",
        limit=f"{math.degrees(BASE_TURN_LIMIT_RAD):.2f} deg",
        got=f"{math.degrees(turn_rad):.2f} deg",
    )


def clamp_moved(head: PointShift, head_mm: Array, limit_mm: float, *, tracker_excluded: bool) -> PatientMoved:
    """Build the error for a head that the frame on its clamp alone shows moved."""
    what = "the head clamp" if tracker_excluded else "the head clamp, or the tracker,"
    return PatientMoved.from_shift(
        f"{what} has moved since the head was localized, by {describe_way(head_mm)}: by the "
        "frame on it, as the spheres are hidden",
        head.rms_mm,
        limit_mm,
    )


def screw_moved(head: PointShift, alone_mm: float, limit_mm: float) -> PatientMoved:
    """Build the error for one moved sphere."""
    return PatientMoved.from_shift(
        f"one sphere has moved by {alone_mm:.1f} mm since it was localized and the other {head.points - 1} "
        "have not: its screw may be loose",
        head.rms_mm,
        limit_mm,
    )


def describe_way(way_mm: Array) -> str:
    """Describe a displacement (3,) mm in the robot frame."""
    x, y, z = way_mm.tolist()
    return f"{np.linalg.norm(way_mm):.2f} mm (x {x:+.2f}, y {y:+.2f}, z {z:+.2f} in the robot frame)"
