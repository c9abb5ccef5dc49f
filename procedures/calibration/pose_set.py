"""Views of a ball for calibration: evenly spread, deterministic tool poses, and checks of their spread.

Every view is tilted away from the reference orientation and rotated about the tool axis. The ball appears at
a different position in the field each time, nearer or farther, so that the lenses can be calibrated too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.calibration.errors import TOO_FEW_POSES, DegeneratePoses, DoesNotFit
from ronna_hw.arrays import Array, Mask
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_against_limit
from ronna_hw.vectors import vector3

TILT_RAD = float(np.radians(25.0))  # at most, in all directions: a spread of 50 degrees
TURN_RAD = float(np.radians(45.0))  # about the tool axis, either way
# How far from the tool centre the ball may be: fully visible to both cameras and sharp enough.
FIELD_MM = (3.5, 9.0, 5.0)
CENTRED_TILT_RAD = float(np.radians(35.0))  # the larger, the more an arm reveals
CENTRED_TURN_RAD = float(np.radians(80.0))
CHECK_TILT_RAD = float(np.radians(25.0))
CHECK_TURN_RAD = float(np.radians(40.0))
CHECK_ORIENTATIONS = 8
# Fractions of rotation and tilt to fall back on, in this order, if an orientation is not reachable.
CHECK_VARIANTS = ((1.0, 1.0), (0.5, 1.0), (0.0, 1.0), (-0.5, 1.0), (-1.0, 1.0), (0.5, 0.7), (-0.5, 0.7))
# Additive recurrence in six dimensions with the generalised golden ratio (x^7 = x + 1): even, never random.
_RATIO = 1.1127756842787055
_STEPS = np.array([_RATIO ** -(k + 1) for k in range(6)])

LEAST_SPREAD_DEG = 8.0  # rms over the poses, for the direction that varies least


@dataclass(frozen=True)
class PlannedLook:
    """Pose ROBOT <- TOOL at which the ball should appear at `ball_in_tool_mm`.

    `orientation` is the number of a self-check orientation, None for the others.
    """

    pose: Transform
    ball_in_tool_mm: tuple[float, float, float]
    orientation: int | None = None


def plan_calibration_looks(reference: Rotation, ball_mm: ArrayLike, count: int) -> tuple[PlannedLook, ...]:
    """Plan views of a ball (3,) in the robot frame, spread around the orientation `reference`."""
    share = (0.5 + np.outer(np.arange(count), _STEPS)) % 1.0
    looks = []
    for one in share:
        offset = np.array(FIELD_MM) * (2.0 * one[3:] - 1.0)
        orientation = _spread_orientation(reference, one, TILT_RAD, TURN_RAD)
        looks.append(_build_look(orientation, np.asarray(ball_mm, dtype=float), offset))
    return tuple(order_by_orientation(looks))


def plan_centred_looks(
    reference: Rotation, sphere_mm: ArrayLike, count: int, first: int = 0
) -> tuple[PlannedLook, ...]:
    """Plan views with the sphere at the tool centre, numbered from `first`.

    Lens and field do not matter there.
    """
    return plan_poses_about(
        reference, sphere_mm, count, first, tilt_rad=CENTRED_TILT_RAD, turn_rad=CENTRED_TURN_RAD
    )


def plan_poses_about(
    reference: Rotation,
    point_mm: ArrayLike,
    count: int,
    first: int = 0,
    *,
    tilt_rad: float,
    turn_rad: float,
    offset_mm: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[PlannedLook, ...]:
    """Plan poses rotated about a point (3,) in the robot frame, at `offset_mm` in the tool frame.

    Tilted by up to `tilt_rad` from the reference, rotated by up to `turn_rad` either way; from number `first`
    on.
    """
    share = (0.5 + np.outer(first + np.arange(count), _STEPS[:3])) % 1.0
    point, offset = np.asarray(point_mm, dtype=float), np.asarray(offset_mm, dtype=float)
    return tuple(
        _build_look(_spread_orientation(reference, one, tilt_rad, turn_rad), point, offset) for one in share
    )


def self_check_variants(reference: Rotation, ball_mm: ArrayLike, number: int) -> tuple[PlannedLook, ...]:
    """List views for one self-check orientation: the preferred one, then alternatives if unreachable."""
    turn = CHECK_TURN_RAD * (1.0 if number % 2 else -1.0)
    azimuth = 2.0 * np.pi * number / CHECK_ORIENTATIONS
    ball = np.asarray(ball_mm, dtype=float)
    return tuple(
        _build_look(
            _tilt_and_turn(reference, tilt_share * CHECK_TILT_RAD, azimuth, turn_share * turn),
            ball,
            np.zeros(3),
            number,
        )
        for turn_share, tilt_share in CHECK_VARIANTS
    )


def order_by_orientation(looks: Sequence[PlannedLook]) -> list[PlannedLook]:
    """Sort views so that each is closest in orientation to the previous one."""
    if not looks:
        return []
    rotations = np.array([look.pose.rotation_matrix for look in looks])
    # The trace of the relative rotation: larger is nearer.
    similarity = np.einsum("nij,mij->nm", rotations, rotations)
    order, unvisited = [0], set(range(1, len(looks)))
    while unvisited:
        nearest = max(unvisited, key=lambda number: float(similarity[order[-1], number]))
        unvisited.remove(nearest)
        order.append(nearest)
    return [looks[number] for number in order]


def move_look(look: PlannedLook, ball_mm: ArrayLike) -> PlannedLook:
    """Return a view moved to another ball position."""
    return _build_look(
        look.pose.rigid.rotation,
        np.asarray(ball_mm, dtype=float),
        np.array(look.ball_in_tool_mm),
        look.orientation,
    )


def _spread_orientation(reference: Rotation, share: Array, tilt_rad: float, turn_rad: float) -> Rotation:
    """Return an orientation within the largest tilt and turn, by shares of tilt, azimuth and turn."""
    tilt, azimuth, turn = share[:3]
    tilted_rad = tilt_rad * float(np.sqrt(tilt))
    return _tilt_and_turn(reference, tilted_rad, 2.0 * np.pi * azimuth, turn_rad * (2.0 * turn - 1.0))


def _tilt_and_turn(reference: Rotation, tilt_rad: float, azimuth_rad: float, turn_rad: float) -> Rotation:
    tilt = Rotation.from_rotvec(tilt_rad * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0]))
    return reference * tilt * Rotation.from_rotvec([0.0, 0.0, turn_rad])


def _build_look(
    orientation: Rotation, ball_mm: Array, offset_mm: Array, number: int | None = None
) -> PlannedLook:
    rigid = RigidTransform.from_components(ball_mm - orientation.apply(offset_mm), orientation)
    return PlannedLook(Transform(Frame.ROBOT, Frame.TOOL, rigid), vector3(offset_mm), number)


def choose_held_out(count: int, validation: int) -> tuple[int, ...]:
    """Choose indices to hold out for validation, evenly spaced in order of orientation."""
    return tuple(sorted({round((number + 0.5) * count / validation) for number in range(validation)}))


def rms_mm(misses_mm: Array) -> float:
    """Return the 3-D rms of misses (m, 3)."""
    return float(np.sqrt(np.mean(np.sum(misses_mm**2, axis=1))))


def require_count(count: int, least: int, what: str, action: str | None = None) -> None:
    """Raise CAL-002 with the message `what` if the count is below the minimum."""
    if count < least:
        raise TOO_FEW_POSES(what, expected=f"at least {least}", got=str(count), action=action)


def require_spread(rotations: Array, what: str, action: str | None = None) -> None:
    """Raise CAL-003 with the message `what` if rotations (n, 3, 3) hardly vary about some axis."""
    if (spread := orientation_spread(rotations)) < math.sin(math.radians(LEAST_SPREAD_DEG)):
        raise DegeneratePoses(
            what,
            limit=f"{LEAST_SPREAD_DEG:g} deg rms about every axis",
            got=f"{format_against_limit(math.degrees(math.asin(spread)), LEAST_SPREAD_DEG, 1)} deg",
            action=action,
        )


def require_scatter(
    scatter_mm: float, largest_mm: float, what: str, action: str | None = None, *, decimals: int = 2
) -> None:
    """Raise CAL-004 with the message `what` if the scatter per axis is larger than anything sound leaves."""
    if scatter_mm > largest_mm:
        got = f"{format_against_limit(scatter_mm, largest_mm, decimals)} mm"
        raise DoesNotFit(what, limit=f"{largest_mm:g} mm per axis", got=got, action=action)


def require_consistent(used: Mask, most_outliers: float, what: str) -> None:
    """Raise CAL-004 if `what` has more than this fraction of outliers; `used` marks the inliers."""
    if (outliers := float(np.mean(~used))) > most_outliers:
        raise DoesNotFit(
            f"too many {what} disagree with the others",
            limit=f"{most_outliers:.0%}",
            got=f"{format_against_limit(100 * outliers, 100 * most_outliers, 0)}%",
        )


def orientation_spread(rotations: Array) -> float:
    """Return the rms variation of rotations (n, 3, 3) in the least varied direction; 0 for a single axis."""
    deviations = rotations - rotations.mean(axis=0)
    scatter = np.einsum("nki,nkj->ij", deviations, deviations) / len(rotations)
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(scatter)[0])))
