"""Shift of a platform since the bases of two arms were measured.

A platform is watched through the frame on its arm, in postures of reference, where the arm's own errors
recur. The tracker may have been moved in between: the frames of the master show by how much.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.errors import DegeneratePoses
from ronna_hw.text import format_against_limit

Array = NDArray[np.float64]

MOVED_MM = 0.2
SEEN_MM = 0.02  # random error of a frame's place per axis: 60 frames of a tracker, and the arm coming back
MOST_UNCERTAIN_MM = MOVED_MM / 2.0  # 3-D, of a shift: a larger one would not show what it must
LEAST_SPREAD_MM = 50.0  # of the master's places in the direction in which they vary second most


@dataclass(frozen=True)
class PlatformShift:
    """Largest shift of the assistant's frame against the master's, and its 3-D standard error, in mm."""

    shift_mm: float
    error_mm: float


def platform_shift(
    master_before_mm: ArrayLike,
    master_mm: ArrayLike,
    assistant_before_mm: ArrayLike,
    assistant_mm: ArrayLike,
    seen_mm: float = SEEN_MM,
    *,
    least_spread_mm: float = LEAST_SPREAD_MM,
    most_uncertain_mm: float = MOST_UNCERTAIN_MM,
) -> PlatformShift:
    """Return the shift of the assistant's places against the master's. Raises CAL-003.

    The master's places (k, 3) show how the tracker has moved, the assistant's (m, 3) are compared with that.
    """
    before, now, other_before, other_now = (
        np.asarray(places, dtype=float)
        for places in (master_before_mm, master_mm, assistant_before_mm, assistant_mm)
    )
    middle, centre = before.mean(axis=0), now.mean(axis=0)
    spread_mm = np.linalg.svd(before - middle, compute_uv=False)[1] / np.sqrt(len(before))
    if spread_mm < least_spread_mm:
        raise DegeneratePoses(
            "the master's postures of reference are too close together, or on one line",
            limit=f"{least_spread_mm:g} mm",
            got=f"{format_against_limit(float(spread_mm), least_spread_mm, 0)} mm",
            action="Have the master show its frame in postures farther apart.",
        )
    turn, _ = Rotation.align_vectors(now - centre, before - middle)
    shifts = other_now - (turn.apply(other_before - middle) + centre)
    farthest = int(np.argmax(np.linalg.norm(shifts, axis=1)))
    error_mm = max(_prediction_error_mm(before - middle, one, seen_mm) for one in other_before - middle)
    if error_mm > most_uncertain_mm:
        raise DegeneratePoses(
            "the postures of reference do not show whether a platform has moved",
            limit=f"{most_uncertain_mm:g} mm",
            got=f"{format_against_limit(error_mm, most_uncertain_mm, 2)} mm",
            action="Have the master show its frame farther apart, and closer to that of the assistant.",
        )
    return PlatformShift(float(np.linalg.norm(shifts[farthest])), error_mm)


def _prediction_error_mm(places_mm: Array, at_mm: Array, seen_mm: float) -> float:
    """Return the 3-D standard error of a shift at a place, both relative to the middle of the places seen."""
    rows = np.vstack([np.hstack([-cross_matrix(one), np.eye(3)]) for one in places_mm])
    # Seen twice: at the calibration and now.
    covariance = 2.0 * seen_mm**2 * np.linalg.inv(rows.T @ rows)
    slope = np.hstack([-cross_matrix(at_mm), np.eye(3)])
    return float(np.sqrt(np.trace(slope @ covariance @ slope.T) + 2.0 * 3.0 * seen_mm**2))


def cross_matrix(vector: Array) -> Array:
    """Return the matrix (3, 3) of the cross product with a vector."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
