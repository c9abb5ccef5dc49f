"""The patient's frame on the head clamp, compared with its place at the localization.

It stands in for the spheres while those are hidden, and tells a pushed tracker from a moved head by any
distance: frame, spheres and the frame on the arm then move as one body. Where the spheres are in view as
well, it is compared with them, so that a frame that has slipped on the clamp is not followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from procedures.registration.movement import NEAR_MM, PointShift, identify_points
from procedures.registration.rigid_fit import as_transform, fit_rigid
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

# Of the frame on the arm from where the push of the tracker must have taken it, 600 mm from the clamp: the
# most in 400 simulated pushes of 2 to 30 mm and up to 1 degree is told in `docs/how-to`; a cart that gives
# way by this much is noticed by `LOCKED_LIMIT_MM` as well.
PUSH_AGREES_MM = 0.3


@dataclass(frozen=True)
class FrameOnClamp:
    """Pose TRACKER <- PATIENT of the frame at rest, and its markers (n, 3), patient frame, mm."""

    pose: Transform
    markers_mm: Array

    @property
    def places_mm(self) -> Array:
        """Markers (n, 3) at rest, tracker frame."""
        return self.pose.apply(self.markers_mm)

    def moved_by(self, move: Transform) -> FrameOnClamp:
        """Return the frame as a tracker sees it that was itself moved, by TRACKER now <- TRACKER before."""
        return replace(self, pose=move @ self.pose)

    def displacements_mm(self, seen: Transform, places_mm: Array) -> Array:
        """Return how far places (n, 3) on the head have moved if they moved with the frame, tracker frame."""
        return (seen @ self.pose.inverse()).apply(places_mm) - places_mm

    def shift(self, seen: Transform, spheres_mm: Array) -> PointShift:
        """Return the shift of the spheres (n, 3) if they moved with the frame."""
        return PointShift.of(self.displacements_mm(seen, spheres_mm))

    def apart_mm(self, seen: Transform, spheres_mm: Array, seen_mm: Array) -> float | None:
        """Return the rms by which frame and spheres have moved differently, at the spheres.

        None if too few of the spheres (n, 3) are identified among the points (m, 3).
        """
        pairs = identify_points(spheres_mm, seen_mm)
        if pairs is None:
            return None
        rows, columns = (list(side) for side in zip(*pairs, strict=True))
        fit = fit_rigid(spheres_mm[rows], seen_mm[columns])
        by_spheres = spheres_mm[rows] @ fit.rotation.T + fit.translation_mm - spheres_mm[rows]
        return PointShift.of(self.displacements_mm(seen, spheres_mm[rows]) - by_spheres).rms_mm


def find_push(
    frame: FrameOnClamp,
    seen: Transform,
    spheres_mm: Array,
    seen_mm: Array,
    arm_mm: tuple[Array, Array],
    limit_mm: float,
) -> Transform | None:
    """Return TRACKER now <- TRACKER before if nothing but the tracker has moved, else None.

    Frame and visible spheres must have moved as one body, by at least `limit_mm` rms and within it, and the
    frame on the arm with them. `spheres_mm` (n, 3) are expected, `seen_mm` (m, 3) seen; `arm_mm` are the
    places (3,) of the frame on the arm, expected and seen.
    """
    before, after = frame.places_mm, seen.apply(frame.markers_mm)
    by_frame = spheres_mm + frame.displacements_mm(seen, spheres_mm)
    if len(seen_mm):
        apart = np.linalg.norm(by_frame[:, None] - seen_mm[None], axis=2)
        near = apart.min(axis=1) < NEAR_MM
        before = np.vstack([before, spheres_mm[near]])
        after = np.vstack([after, seen_mm[apart.argmin(axis=1)[near]]])
    fit = fit_rigid(before, after)
    move = Transform(Frame.TRACKER, Frame.TRACKER, as_transform(fit.rotation, fit.translation_mm))
    expected_mm, at_mm = arm_mm
    agrees = (
        PointShift.of(move.apply(before) - after).rms_mm < limit_mm
        and float(np.linalg.norm(move.apply(expected_mm) - at_mm)) < PUSH_AGREES_MM
    )
    return move if agrees and PointShift.of(after - before).rms_mm >= limit_mm else None
