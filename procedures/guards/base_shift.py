"""Displacement of the frame on the arm since earlier readings: has the cart, or the tracker, been moved?

The frame is compared by the difference of its places according to tracker and arm. As the mount is some
millimetres off its drawing, this difference depends on the arm's orientation, so it is compared with earlier
readings in the same orientation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.guards.room_reading import RoomReading
from procedures.guards.stability import BASE_NOTICEABLE_MM
from ronna_hw.frames import Transform

Array = NDArray[np.float64]

# Half of the 1.7 mm that must be noticed at any rest of the arm. In one pose, reached from different sides,
# backlash displaces the frame by `BACKLASH_MM` at most in 800 simulated pairs.
BASE_LIMIT_MM = 0.85
BACKLASH_MM = 0.52
# In another pose of the same orientation arm and tracker err differently: 0.96 mm at most in 360 pairs.
OTHER_POSE_LIMIT_MM = 1.3
# In any pose: a mount 3.5 mm off its drawing makes twice that between opposite orientations, arm and tracker
# some 1 mm.
GROSS_LIMIT_MM = 10.0
# Of the frame on the arm against the arm, between careful looks in the very same settled pose. By noise it is
# 0.4 to 1.3 mrad, in two whole simulated cases; sunlight doubles it. At a head 700 mm from the frame the
# limit makes 2.8 mm.
BASE_TURN_LIMIT_RAD = 4e-3
SAME_ORIENTATION_RAD = math.radians(1.0)  # 3.5 mm of the mount make 0.06 mm
FARTHEST_MM = 150.0  # between poses that are compared: the tracker's bias changes with the place
SAME_POSE_RAD, SAME_POSE_MM = math.radians(0.1), 1.0


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

    @property
    def backlash_mm(self) -> float:
        """Displacement that backlash alone may make in the pose of that reading."""
        return 0.0 if self.limit_mm <= BASE_NOTICEABLE_MM else BACKLASH_MM


def base_shift(
    references: Sequence[RoomReading], reading: RoomReading, before_push: int = 0
) -> BaseShift | None:
    """Return a shift over its limit, else the most tightly limited one, or None without a reference.

    The first `before_push` references are from before a followed push of the tracker.
    """
    if reading.frame_mm is None:
        return None
    shifts = [
        BaseShift(reading.frame_mm - one.frame_mm, limit_mm, exact)
        for one, limit_mm, exact in _comparable(references, reading, before_push)
        if one.frame_mm is not None
    ]
    return min(shifts, key=lambda shift: (shift.moved_mm < shift.limit_mm, shift.limit_mm), default=None)


def base_turn_rad(references: Sequence[RoomReading], reading: RoomReading) -> float | None:
    """Return by how much the frame on the arm has turned against the arm since the oldest comparable reading.

    A cart that turned about the frame leaves the frame in its place. None without a reading in the same pose.
    """
    if reading.robot_from_tracker is None or not reading.is_comparable:
        return None
    for one in references:
        before = one.robot_from_tracker
        same = _same_pose(one.robot_from_flange, reading.robot_from_flange)
        if before is not None and one.is_comparable and same:
            return _angle_between_rad(before, reading.robot_from_tracker)
    return None


def gross_shift(references: Sequence[RoomReading], reading: RoomReading) -> BaseShift | None:
    """Return a shift that is plain although no earlier reading is comparable, or None."""
    shift = nearest_shift(references, reading)
    return shift if shift is not None and shift.moved_mm >= GROSS_LIMIT_MM else None


def nearest_shift(references: Sequence[RoomReading], reading: RoomReading) -> BaseShift | None:
    """Return the shift since the reading in the most similar orientation, or None without one."""
    if reading.frame_mm is None:
        return None
    here = reading.robot_from_flange
    framed = (
        (_angle_between_rad(one.robot_from_flange, here), number, one.frame_mm)
        for number, one in enumerate(references)
        if one.frame_mm is not None
    )
    nearest = min(framed, default=None)
    if nearest is None:
        return None
    return BaseShift(reading.frame_mm - nearest[2], GROSS_LIMIT_MM, exact=False)


def _comparable(
    references: Sequence[RoomReading], reading: RoomReading, before_push: int
) -> list[tuple[RoomReading, float, bool]]:
    """Return comparable earlier readings as (reading, limit in mm, whether the pose is the same).

    In the same pose: the oldest, so that a slow drift adds up, and the oldest that may differ by noise
    only. Otherwise the nearest in the same orientation, and the newest of those equally near. Since a
    followed push, readings differ from those before by more than noise: by how well the push is known.
    """
    here = reading.robot_from_flange
    alike = [
        (apart_mm, -number, one)
        for number, one in enumerate(references)
        if _angle_between_rad(one.robot_from_flange, here) <= SAME_ORIENTATION_RAD
        and (apart_mm := _distance_mm(one.robot_from_flange, here)) <= FARTHEST_MM
    ]
    exact = [one for one in references if _same_pose(one.robot_from_flange, here)]
    if not exact:
        return [(min(alike)[2], OTHER_POSE_LIMIT_MM, False)] if alike else []
    settled = [
        one
        for one in references[before_push:]
        if reading.is_comparable and one.is_comparable and _same_pose(one.robot_from_flange, here)
    ]
    return [(exact[0], BASE_LIMIT_MM, True), *((one, BASE_NOTICEABLE_MM, True) for one in settled[:1])]


def _same_pose(one: Transform, other: Transform) -> bool:
    return _angle_between_rad(one, other) < SAME_POSE_RAD and _distance_mm(one, other) < SAME_POSE_MM


def _distance_mm(one: Transform, other: Transform) -> float:
    return math.dist(one.translation_mm, other.translation_mm)


def _angle_between_rad(one: Transform, other: Transform) -> float:
    between = one.rotation_matrix.T @ other.rotation_matrix
    return math.acos(min(1.0, max(-1.0, (float(np.trace(between)) - 1.0) / 2.0)))
