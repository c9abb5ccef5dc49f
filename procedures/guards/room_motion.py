"""Errors for what has moved in the room, in the words of the operator."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from procedures.calibration.errors import PlatformMoved
from procedures.guards import errors
from procedures.guards.head_frames import PATIENT_LIMIT_MM
from procedures.guards.room_reading import RoomReading, find_ghosts
from procedures.registration.movement import (
    LEAST_POINTS,
    NEAR_MM,
    PointShift,
    lone_displacement_mm,
)
from procedures.registration.rigid_fit import as_transform, fit_rigid
from procedures.room.motion import Moved, RoomMotion
from procedures.room.sighting import Sighting, Tracked
from procedures.workcell.tracker_move import STILL
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_count, format_distinct

# Safety against a cart that was rolled (U).
GROSS_LIMIT_MM = 10.0  # of the frame on the arm: no hand on guide or arm moves it so far
# Safety against a sphere at a place where none is known (U).
NEAR_HEAD_MM = 60.0  # from a known sphere: anything that reflects there is taken for a sphere of the head

HELD = (
    "Let go of guide and arm, check that mount and frame are tight and the cart locked. Send the arm home, "
    "then run the step again: there the next look tells whether anything has moved. If it shows nothing and "
    "this comes again, localize again."
)


@dataclass(frozen=True)
class HeadSeen:
    """Displacement of the head by its spheres or, while those are hidden, by the frame on its clamp."""

    shift: PointShift
    by_frame: bool

    @classmethod
    def of(cls, expected: Expected) -> HeadSeen | None:
        """Compare a look with what is expected in it; None if too little of the head is seen."""
        spheres = expected.look.spheres
        if len(spheres.numbers) >= LEAST_POINTS:
            before_mm = expected.spheres_mm[list(spheres.numbers)]
            fit = fit_rigid(before_mm, spheres.places_mm)
            after_mm = before_mm @ fit.rotation.T + fit.translation_mm
            return cls(PointShift.of(after_mm - before_mm), by_frame=False)
        clamp = expected.look.frames.get(Tracked.CLAMP)
        if clamp is not None and expected.clamp_mm is not None:
            return cls(PointShift.of(clamp.markers_mm - expected.clamp_mm), by_frame=True)
        return None


@dataclass(frozen=True)
class Expected:
    """Expected places of everything in a look, tracker frame of the localization.

    `spheres_mm` (n, 3) and `clamp_mm` (m, 3), None without a frame on the clamp; `marker` is the frame on the
    arm by the arm alone, ROBOT <- MARKER, and `arm_way_mm` (3,) how far it is seen from where earlier looks
    have it, robot frame, None if not seen. `sensors_mm` (2, 3) are the tracker's own.
    """

    look: Sighting
    spheres_mm: Array
    clamp_mm: Array | None
    robot_from_tracker: Transform
    marker: Transform
    arm_way_mm: Array | None
    sensors_mm: Array


def push_of_tracker(expected: Expected) -> Transform | None:
    """Return TRACKER now <- TRACKER before as it would explain where the head is seen, or None."""
    spheres, frames = expected.look.spheres, expected.look.frames
    before = [expected.spheres_mm[list(spheres.numbers)].reshape(-1, 3)]
    after = [spheres.places_mm]
    if (clamp := frames.get(Tracked.CLAMP)) is not None and expected.clamp_mm is not None:
        before.append(expected.clamp_mm)
        after.append(clamp.markers_mm)
    if sum(map(len, before)) < LEAST_POINTS:
        return None
    if (arm := frames.get(Tracked.ARM)) is not None and expected.arm_way_mm is not None:
        way_mm = expected.robot_from_tracker.rotation_matrix.T @ expected.arm_way_mm
        before.append(arm.place_mm[None] - way_mm)
        after.append(arm.place_mm[None])
    fit = fit_rigid(np.vstack(before), np.vstack(after))
    return Transform(Frame.TRACKER, Frame.TRACKER, as_transform(fit.rotation, fit.translation_mm))


def name_motion(
    motion: RoomMotion, expected: Expected, reading: RoomReading, *, approached: bool = False
) -> errors.RoomMoved | errors.RoomUndecided | errors.InsertionDisturbed:
    """Return the error for a motion that a reading shows; `approached`: with the guide at the head."""
    got, limit = (f"{one} mm" for one in format_distinct(motion.moved_mm, motion.limit_mm, 2))
    way = describe_way(motion.way_mm)
    where = "" if motion.at is None else f", at {motion.at}"
    match motion.moved:
        case Moved.ASSISTANT if reading.instrument_led:
            return errors.InsertionDisturbed(
                f"the tracker sees the assistant beside its axis, by {way}, with the instrument in the "
                "guide: a cart was displaced, or a frame",
                limit=limit,
                got=got,
                action=errors.InsertionDisturbed.by_hand,
            )
        case Moved.ASSISTANT:
            moved = PlatformMoved(
                "the tracker sees the frame on the assistant elsewhere than its joints have it, by "
                f"{way}{where}: its cart was moved, or the frame",
                limit=limit,
                got=got,
            )
            x, y, z = motion.way_mm.tolist()
            moved.way_mm = (x, y, z)
            return moved
        case Moved.BASE | Moved.SEVERAL if approached and motion.moved_mm < GROSS_LIMIT_MM:
            several = (
                ", or two of head, cart and tracker" if motion.moved is Moved.SEVERAL else ", or the cart"
            )
            return errors.RoomUndecided(
                f"the frame on the arm is not where the arm has it, by {way}{where}: the guide is pushed or "
                f"held{several} {'were' if motion.moved is Moved.SEVERAL else 'was'} moved",
                limit=limit,
                got=got,
                action=HELD,
            )
        case Moved.BASE | Moved.TRACKER | Moved.SEVERAL:
            return _base_shifted(motion, expected, reading, f"{way}{where}", limit, got)
        case Moved.CLAMP_FRAME:
            return errors.FrameSlipped(
                "the patient's frame has moved on the head clamp since the localization, against the spheres",
                limit=limit,
                got=got,
            )
        case Moved.HEAD_OR_TRACKER if expected.clamp_mm is not None and not _is_home(reading):
            return errors.RoomUndecided(
                "the tracker, or the head with its clamp, was moved: the frame on the arm tells which of "
                "them only in a pose in which it was seen before, such as home",
                limit=limit,
                got=got,
            )
        case _:
            return _patient_moved(motion, expected, reading, f"{way}{where}")


def _is_home(reading: RoomReading) -> bool:
    """Whether the frame on the arm is seen in the pose in which it is known best."""
    return reading.settled_home and reading.on_arm is not None


def _base_shifted(
    motion: RoomMotion, expected: Expected, reading: RoomReading, way: str, limit: str, got: str
) -> errors.BaseShifted:
    cart = motion.moved is not Moved.TRACKER
    if not cart:  # what it sees moves against it
        way = describe_way(-motion.way_mm)
    what = "the cart of the robot was moved, the frame on the arm" if cart else "the tracker was moved"
    if cart and motion.moved_mm < GROSS_LIMIT_MM:
        what = "the cart of the robot was moved, or somebody leans on arm or guide: the frame on the arm"
    if motion.moved is Moved.SEVERAL:
        what = "head and arm show that two of head, cart and tracker were moved, one of them"
    elif cart and motion.at is not None:
        what = "the cart of the robot was moved or turned, or somebody leans on arm or guide,"
    if cart and HeadSeen.of(expected) is None:  # nothing tells it from a pushed tracker
        what = what.replace("the cart of the robot was", "the cart of the robot, or the tracker, was")
    shifted = errors.BaseShifted(f"{what} by {way}", limit=limit, got=got)
    shifted.cart = cart
    if cart and motion.moved_mm >= GROSS_LIMIT_MM / 2.0:
        shifted.room_moved = _room_moved(expected, reading)
    return shifted


def _room_moved(expected: Expected, reading: RoomReading) -> Transform | None:
    """Displacement of head and clamp against a moved cart, robot frame, as far as one look tells."""
    if reading.on_arm is None:
        return None
    by_frame = expected.marker @ reading.on_arm.inverse()
    # How the tracker sees the head displaced; it may have been moved as well.
    push = push_of_tracker(replace(expected, arm_way_mm=None)) or STILL
    return by_frame @ push @ expected.robot_from_tracker.inverse()


def _patient_moved(
    motion: RoomMotion, expected: Expected, reading: RoomReading, way: str
) -> errors.PatientMoved:
    head = HeadSeen.of(expected)
    tracker = motion.moved is Moved.HEAD_OR_TRACKER
    alone_mm = lone_displacement_mm(
        expected.spheres_mm, reading.spheres_mm, max(motion.limit_mm, PATIENT_LIMIT_MM)
    )
    if alone_mm is not None and head is not None and not head.by_frame:
        what = (
            f"one sphere has moved by {alone_mm:.1f} mm since it was localized and the other "
            f"{head.shift.points - 1} have not: its screw may be loose"
        )
    elif motion.moved is Moved.HEAD_IN_CLAMP:
        what = (
            f"the head has moved in its clamp since it was localized, by {way}: the frame on the clamp is in "
            "its place"
        )
    elif head is not None and head.by_frame:
        what = (
            f"the head clamp{', or the tracker,' if tracker else ''} has moved since the head was localized, "
            f"by {way}: by the frame on it"
            + (", as the spheres are hidden" if len(expected.spheres_mm) else "")
        )
    else:
        seen = f", the mean of {format_count(head.shift.points, 'sphere')}" if head and not motion.at else ""
        what = f"the head{', or the tracker,' if tracker else ''} has moved since it was localized"
        what += f", by {way}{seen}"
    on_skin = not len(expected.spheres_mm)
    # The points of the frame on the clamp say nothing of a head that has moved in it, and little of a turn.
    by_points = head is not None and not (head.by_frame and motion.moved is Moved.HEAD_IN_CLAMP)
    if head is None or not by_points or head.shift.rms_mm <= motion.limit_mm:
        return errors.PatientMoved.from_shift(what, motion.moved_mm, motion.limit_mm, "", on_skin=on_skin)
    moved_mm = head.shift.rms_mm
    # The limit on the mean way, as one on the rms of the points.
    limit_mm = motion.noticed_share * max(moved_mm, motion.moved_mm)
    return errors.PatientMoved.from_shift(what, moved_mm, limit_mm, on_skin=on_skin)


def find_unseen(expected: Expected, reading: RoomReading) -> errors.PatientUnseen | None:
    """Return the error for points near the head at no known position, which may be displaced spheres.

    Only where fewer than three known spheres are seen of a head that has as many. Ghosts do not count.
    """
    seen_mm = reading.spheres_mm
    head = HeadSeen.of(expected)
    if (
        not len(seen_mm)
        or len(expected.spheres_mm) < LEAST_POINTS
        or (head is not None and not head.by_frame)
    ):
        return None
    apart = np.linalg.norm(seen_mm[:, None] - expected.spheres_mm[None], axis=2).min(axis=1)
    ghosts = find_ghosts(expected.spheres_mm, reading.markers_mm, seen_mm, expected.sensors_mm)
    unknown_count = int(((apart >= NEAR_MM) & (apart < NEAR_HEAD_MM) & ~ghosts).sum())
    if not unknown_count:
        return None
    return errors.PatientUnseen(
        f"the tracker sees {format_count(unknown_count, 'sphere')} near the head at no known position",
        expected="at least three known spheres in place",
    )


def describe_way(way_mm: Array) -> str:
    """Describe a displacement (3,) mm in the robot frame."""
    x, y, z = way_mm.tolist()
    return f"{math.hypot(x, y, z):.2f} mm (x {x:+.2f}, y {y:+.2f}, z {z:+.2f} in the robot frame)"
