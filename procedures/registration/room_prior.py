"""Evidence from the room about a pose physical <- image: gravity, the patient's body, lines of sight.

Distances do not change when an image is mirrored. The fit of a mirrored flat set is the true head reflected
in the plane of the spheres: on the wrong side of them. Where the room does not exclude a mirrored image, a
landmark of the head that a person touches tells both apart. Image coordinates are LPS.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import RigidTransform

from ronna_hw.arrays import Array

UP = np.array([0.0, 0.0, 1.0])  # in the room
SUPERIOR = np.array([0.0, 0.0, 1.0])
MIRROR = np.array([-1.0, 1.0, 1.0])  # left and right; any other mirror image is this one turned
# A ray that comes this near to the head's centre, as a share of its axes, passes through the head. A head is
# no ellipsoid: only a quarter of its radius below the surface does the ellipsoid count.
SOLID_SHARE = 0.75
LYING_SHARE = 0.5  # of the head's axis that is horizontal; below it the patient sits over the floor
COS_BODY = math.cos(math.radians(30.0))  # seen from above, the body is within this angle of the head's axis

# Of the frame on its clamp from the middle of a head.
# Safety against a head that was measured or touched elsewhere than it is. Source: half a head, a clamp and an
# arm for the frame, as they are usual (U).
MOST_FROM_CLAMP_MM = 400.0

# The 24 ways in which a stored image becomes a mirror image: its axes exchanged or reversed. Those first that
# leave the slices' axis alone, as columns, rows or slices reversed and rows and columns swapped.
MIRRORS = sorted(
    (
        np.eye(3)[list(order)] * signs
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
        if np.linalg.det(np.eye(3)[list(order)] * signs) < 0.0
    ),
    key=lambda one: abs(one[2, 2]),
    reverse=True,
)
WITHIN_SLICES = sum(bool(one[2, 2]) for one in MIRRORS)
LANDMARKS = {  # points of a head that a person finds and can touch: directions from its centre, LPS
    "crown of the head": (0.0, 0.0, 1.0),
    "tip of the nose": (0.0, -1.0, 0.0),
    "back of the head": (0.0, 1.0, 0.0),
    "left ear": (1.0, 0.0, 0.0),
    "right ear": (-1.0, 0.0, 0.0),
}
SIDES = (("left", "right"), ("back", "front"), ("crown", "feet"))  # of a patient, along and against LPS
NAMED_SHARE = 0.5  # of an offset, for its part along an axis to be named
LEAST_APART_MM = 15.0  # between the landmark as matched and as mirrored, for a reading to tell them apart
# A head is an ellipsoid only roughly. Mirror images that exchange the slices' axis count only beyond this:
# they are rare, and a viewer shows them.
READING_LIMIT_MM = 40.0


@dataclass(frozen=True, eq=False)
class HeadSight:
    """Head ellipsoid in the image, and tracker sensors (n, 3) in the room, mm.

    The tracker cannot have seen a sphere through the head.
    """

    centre_mm: Array
    semi_axes_mm: Array
    eyes_mm: Array

    def objection(self, rotation: Array, translation_mm: Array, physical_mm: Array) -> str:
        """State how many of the points (k, 3) the head would hide in this pose; return '' for none."""
        hidden = self.count_hidden(rotation, translation_mm, physical_mm)
        return f"the head would hide {hidden} of the spheres that the tracker sees" if hidden else ""

    def count_hidden(self, rotation: Array, translation_mm: Array, physical_mm: Array) -> int:
        """Return how many of the points (k, 3) the head would hide from the tracker, or have inside."""
        eyes, points = (
            ((places - translation_mm) @ rotation - self.centre_mm) / self.semi_axes_mm
            for places in (self.eyes_mm[:, None], physical_mm)
        )
        rays = points - eyes
        share = np.clip(-(rays * eyes).sum(axis=-1) / np.square(rays).sum(axis=-1), 0.0, 1.0)
        nearest = np.linalg.norm(eyes + share[..., None] * rays, axis=-1).min(axis=0)
        return int((nearest < SOLID_SHARE).sum())

    def mirrored(self) -> HeadSight:
        """Return the sight for a mirrored head."""
        return replace(self, centre_mm=self.centre_mm * MIRROR)


@dataclass(frozen=True, eq=False)
class RoomPrior:
    """Head poses allowed by gravity, the patient's body and the tracker's line of sight.

    `lying_up` (3,) is the patient's side that is up when lying flat; `recline_deg` is the range by which the
    upper body is raised from there, `tolerance_deg` how far the head may be turned or tilted beyond it. The
    base of the arm is the origin of the room, its z axis vertical. `clamp_mm` (3,) is where the tracker sees
    the frame on the head's clamp, if there is one.
    """

    lying_up: Array
    recline_deg: tuple[float, float]
    tolerance_deg: float
    sight: HeadSight
    clamp_mm: Array | None = None

    def objection(self, rotation: Array, translation_mm: Array, physical_mm: Array) -> str:
        """State the first evidence against this pose; return '' if there is none."""
        middle_mm = rotation @ self.sight.centre_mm + translation_mm
        sight_objection = self.sight.objection(rotation, translation_mm, physical_mm)
        return self.check_position(rotation, middle_mm) or sight_objection

    def check_position(self, rotation: Array, middle_mm: Array) -> str:
        """State any evidence against the patient's position, given the head's orientation and centre."""
        return (
            self._check_gravity(rotation)
            or self._check_body(rotation, middle_mm)
            or self._check_clamp(rotation, middle_mm)
        )

    def _check_gravity(self, rotation: Array) -> str:
        up = rotation.T @ UP
        leans_rad = math.atan2(up @ SUPERIOR, up @ self.lying_up)
        low_rad, high_rad = map(math.radians, self.recline_deg)
        nearest = (low_rad, high_rad, min(max(leans_rad, low_rad), high_rad))
        cosine = max(up @ (math.cos(one) * self.lying_up + math.sin(one) * SUPERIOR) for one in nearest)
        off_deg = math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
        if off_deg <= self.tolerance_deg:
            return ""
        return (
            f"the head would be turned {off_deg:.0f} deg beyond the planned patient position, "
            f"limit {self.tolerance_deg:.0f} deg"
        )

    def _check_body(self, rotation: Array, middle_mm: Array) -> str:
        body, base = -(rotation @ SUPERIOR)[:2], -middle_mm[:2]
        if np.linalg.norm(body) < LYING_SHARE:
            return ""
        cosine = body @ base / max(np.linalg.norm(body) * np.linalg.norm(base), 1e-9)
        return "the arm would stand where the patient's body is" if cosine > COS_BODY else ""

    def _check_clamp(self, rotation: Array, middle_mm: Array) -> str:
        if self.clamp_mm is None:
            return ""
        away_mm = float(np.linalg.norm(self.clamp_mm - middle_mm))
        if away_mm > MOST_FROM_CLAMP_MM:
            return (
                f"the middle of the head would be {away_mm:.0f} mm from the frame on its clamp, "
                f"limit {MOST_FROM_CLAMP_MM:g} mm"
            )
        translation_mm = middle_mm - rotation @ self.sight.centre_mm
        hidden = self.sight.count_hidden(rotation, translation_mm, self.clamp_mm[None])
        return "the head would hide the frame on its clamp, which the tracker sees" if hidden else ""


@dataclass(frozen=True, eq=False)
class Landmark:
    """Landmark on the head in the room: its matched position, and those in mirror images (n, 3)."""

    name: str
    direction: tuple[float, float, float]
    matched_mm: Array
    mirrored_mm: Array

    @property
    def apart_mm(self) -> float:
        """Distance to the nearest mirror image."""
        return float(np.linalg.norm(self.mirrored_mm - self.matched_mm, axis=1).min())

    @property
    def limit_mm(self) -> float:
        """Largest accepted distance of a reading from the match, at most half that of a mirror image."""
        return min(READING_LIMIT_MM, 0.5 * self.apart_mm)

    def may_be_mirrored(self, point_mm: Array) -> bool:
        """Whether a point touched away from the match may be this landmark in a mirrored CT.

        Mirror images within the limit of the match are not among those listed, but may be touched.
        """
        from_match_mm = float(np.linalg.norm(point_mm - self.matched_mm))
        from_mirrored_mm = float(np.linalg.norm(self.mirrored_mm - point_mm, axis=1).min())
        return min(from_mirrored_mm, from_match_mm - READING_LIMIT_MM) <= READING_LIMIT_MM


def describe_side(offset_mm: Array) -> str:
    """Describe in words toward which sides of the patient an offset (3,) in LPS mm leads."""
    length_mm = float(np.linalg.norm(offset_mm))
    return "toward the patient's " + " and ".join(
        SIDES[axis][int(offset_mm[axis] < 0.0)]
        for axis in np.argsort(-np.abs(offset_mm))
        if abs(offset_mm[axis]) >= NAMED_SHARE * length_mm
    )


def choose_landmark(
    matched: RigidTransform, mirrored: Iterable[RigidTransform], prior: RoomPrior
) -> Landmark | None:
    """Choose the landmark that best distinguishes a match from its mirror images; return None if none does.

    Landmarks on the patient's underside are left out. `mirrored` are the poses physical <- image * MIRROR
    that fit the same spheres in view of the tracker; of each, the orientations count that the prior does not
    exclude.
    """
    centre_mm, semi_mm = prior.sight.centre_mm, prior.sight.semi_axes_mm
    poses: list[tuple[Array, Array, Array, bool]] = []
    for pose in mirrored:
        middle_mm = pose.apply(centre_mm * MIRROR)
        for number, mirror in enumerate(MIRRORS):
            rotation = pose.rotation.as_matrix() @ np.diag(MIRROR) @ mirror.T
            if not prior.check_position(rotation, middle_mm):
                poses.append((rotation, middle_mm, np.abs(mirror) @ semi_mm, number < WITHIN_SLICES))
    candidates = []
    for name, direction in LANDMARKS.items():
        first = matched.apply(centre_mm + semi_mm * direction)
        others = [(middle + turned @ (semi * direction), usual) for turned, middle, semi, usual in poses]
        counted = [
            other for other, usual in others if usual or np.linalg.norm(other - first) > READING_LIMIT_MM
        ]
        if counted and prior.lying_up @ direction >= 0.0:
            candidates.append(Landmark(name, direction, first, np.array(counted)))
    return max(
        candidates,
        key=lambda one: (one.apart_mm >= LEAST_APART_MM, len(one.mirrored_mm), one.apart_mm),
        default=None,
    )
