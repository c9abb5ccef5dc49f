"""The patient's frame on the head clamp, compared with its place at the localization.

It stands in for the spheres while those are hidden, and tells a pushed tracker from a moved head by any
distance: frame, spheres and the frame on the arm then move as one body. Where the spheres are in view as
well, it is compared with them, so that a frame that has slipped on the clamp is not followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from procedures.registration.movement import NEAR_MM, PointShift
from procedures.registration.rigid_fit import as_transform, fit_rigid
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

# Of the frame on the arm from where the push of the tracker took it, 600 mm from the clamp, in a careful look
# and in a short one: with the spheres hidden, the noise of a push that the frame on the clamp shows alone is
# 0.17 mm rms there in 60 frames and 0.37 mm in 12.
PUSH_AGREES_MM, PUSH_AGREES_SHORTLY_MM = 0.5, 0.85


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

    def shift(self, seen: Transform) -> PointShift:
        """Return the shift of the frame's own markers.

        At the spheres, 200 mm away, the frame's rotation would show its noise and not a movement.
        """
        return PointShift.of(self._displacements_mm(seen))

    def apart_mm(self, seen: Transform, head: PointShift) -> float:
        """Return the rms by which the frame's markers have moved otherwise than the head's centroid."""
        return PointShift.of(self._displacements_mm(seen) - head.mean_mm).rms_mm

    def _displacements_mm(self, seen: Transform) -> Array:
        return seen.apply(self.markers_mm) - self.places_mm


def find_push(
    frame: FrameOnClamp,
    seen: Transform,
    spheres_mm: Array,
    seen_mm: Array,
    arm_mm: tuple[Array, Array],
    limits_mm: tuple[float, float],
) -> Transform | None:
    """Return TRACKER now <- TRACKER before if nothing but the tracker has moved, else None.

    Frame and visible spheres must each have moved by at least the first of `limits_mm` (rms), as one body
    within it, and the frame on the arm with them, within the second. A push that would take the frame on the
    arm by less than twice that is not decided here: a small move of the head would pass for it.
    `spheres_mm` (n, 3) are expected, `seen_mm` (m, 3) seen; `arm_mm` are the places (3,) of the frame on the
    arm, expected and seen.
    """
    limit_mm, arm_limit_mm = limits_mm
    bodies = [(frame.places_mm, seen.apply(frame.markers_mm))]
    by_frame = (seen @ frame.pose.inverse()).apply(spheres_mm)
    if len(seen_mm):
        apart = np.linalg.norm(by_frame[:, None] - seen_mm[None], axis=2)
        if (near := apart.min(axis=1) < NEAR_MM).any():
            bodies.append((spheres_mm[near], seen_mm[apart.argmin(axis=1)[near]]))
    if any(PointShift.of(now - then).rms_mm < limit_mm for then, now in bodies):
        return None
    before, after = (np.vstack(side) for side in zip(*bodies, strict=True))
    move = _fit(before, after)
    expected_mm, at_mm = arm_mm
    pushed_mm = move.apply(expected_mm)
    if (
        PointShift.of(move.apply(before) - after).rms_mm >= limit_mm
        or float(np.linalg.norm(pushed_mm - at_mm)) >= arm_limit_mm
        or float(np.linalg.norm(pushed_mm - expected_mm)) < 2.0 * arm_limit_mm
    ):
        return None
    return _fit(np.vstack([before, expected_mm]), np.vstack([after, at_mm]))  # one body, so all of it counts


def _fit(before_mm: Array, after_mm: Array) -> Transform:
    fit = fit_rigid(before_mm, after_mm)
    return Transform(Frame.TRACKER, Frame.TRACKER, as_transform(fit.rotation, fit.translation_mm))
