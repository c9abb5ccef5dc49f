"""The patient's frame on the head clamp, compared with its place at the localization.

It stands in for the spheres while those are hidden, and tells a pushed tracker from a moved head by any
distance: frame, spheres and the frame on the arm then move as one body. Where the spheres are in view as
well, it is compared with them, so that a frame that has slipped on the clamp is not followed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.registration.movement import LEAST_POINTS, NEAR_MM, PointShift
from procedures.registration.rigid_fit import as_transform, fit_rigid
from ronna_hw.frames import Frame, Transform

Array = NDArray[np.float64]

# Of the frame on the arm from where the push of the tracker took it, 600 mm from the clamp, in a careful
# look, with the spheres seen and hidden. Of 200 simulated pushes, 199 and 189 are followed; with a head that
# moved meanwhile by 0.5 mm, 1 and 95.
PUSH_AGREES_MM, PUSH_AGREES_HIDDEN_MM = 0.3, 0.5
PUSH_NOISE_MM, PUSH_NOISE_HIDDEN_MM = 0.13, 0.28  # rms of the same, in pure pushes


@dataclass(frozen=True)
class FrameOnClamp:
    """Pose TRACKER <- PATIENT of the frame at rest, and its markers (n, 3), patient frame, mm."""

    pose: Transform
    markers_mm: Array

    @property
    def places_mm(self) -> Array:
        """Markers (n, 3) at rest, tracker frame."""
        return self.pose.apply(self.markers_mm)

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


@dataclass(frozen=True)
class ArmFrameSeen:
    """Places (3,) of the frame on the arm, tracker frame: expected and seen."""

    expected_mm: Array
    seen_mm: Array

    def off_mm(self, move: Transform) -> float:
        """Return how far the frame is from where a push of the tracker would have taken it."""
        return float(np.linalg.norm(move.apply(self.expected_mm) - self.seen_mm))


@dataclass(frozen=True)
class HeadMove:
    """Move TRACKER <- TRACKER of frame on the clamp and visible spheres, which have moved as one body.

    `before_mm` and `after_mm` (n, 3) are their points. `spheres_seen` says whether spheres are among them.
    """

    move: Transform
    before_mm: Array
    after_mm: Array
    spheres_seen: bool

    @property
    def agrees_mm(self) -> float:
        """Largest distance of the frame on the arm at which it counts as pushed alike."""
        return PUSH_AGREES_MM if self.spheres_seen else PUSH_AGREES_HIDDEN_MM

    @property
    def unnoticed_mm(self) -> float:
        """Move of the head during a push that may pass for it."""
        return self.agrees_mm + (PUSH_NOISE_MM if self.spheres_seen else PUSH_NOISE_HIDDEN_MM)

    def as_push(self, arm: ArmFrameSeen) -> Transform | None:
        """Return TRACKER now <- TRACKER before if nothing but the tracker has moved, else None.

        The frame on the arm must have moved alike. A push that would take it by less than twice the limit is
        not decided here: a small move of the head would pass for it.
        """
        way_mm = float(np.linalg.norm(self.move.apply(arm.expected_mm) - arm.expected_mm))
        if arm.off_mm(self.move) >= self.agrees_mm or way_mm < 2.0 * self.agrees_mm:
            return None
        before_mm = np.vstack([self.before_mm, arm.expected_mm])
        return _fit(before_mm, np.vstack([self.after_mm, arm.seen_mm]))  # one body, so all of it counts


def find_head_move(
    frame: FrameOnClamp, seen: Transform, spheres_mm: Array, seen_mm: Array, limit_mm: float
) -> HeadMove | None:
    """Return the move that frame on the clamp and visible spheres share, or None.

    Each must have moved by at least `limit_mm` (rms), as one body within it. `spheres_mm` (n, 3) are
    expected, `seen_mm` (m, 3) seen.
    """
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
    if PointShift.of(move.apply(before) - after).rms_mm >= limit_mm:
        return None
    return HeadMove(move, before, after, spheres_seen=len(before) >= len(frame.markers_mm) + LEAST_POINTS)


def _fit(before_mm: Array, after_mm: Array) -> Transform:
    fit = fit_rigid(before_mm, after_mm)
    return Transform(Frame.TRACKER, Frame.TRACKER, as_transform(fit.rotation, fit.translation_mm))
