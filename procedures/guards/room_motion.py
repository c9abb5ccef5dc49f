"""What has moved in the room, by the displacements of head and frame on the arm: words and errors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from procedures.guards.base_shift import BASE_LIMIT_MM, BaseShift
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.registration.movement import PointShift
from ronna_hw.text import format_against_limit

Array = NDArray[np.float64]


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
        f"{'the tracker' if tracker else 'the cart of the robot'} was moved by {describe_way(way_mm)}",
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
