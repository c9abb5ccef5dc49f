"""Whether a mirrored image would explain the room as well, and which point of the head tells them apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from procedures.registration.room_prior import MIRROR, RoomPrior

Array = NDArray[np.float64]

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
LEAST_APART_MM = 15.0  # between the landmark as matched and as mirrored, for a reading to tell them apart
# A head is an ellipsoid only roughly. Mirror images that exchange the slices' axis count only beyond this:
# they are rare, and a viewer shows them.
READING_LIMIT_MM = 40.0


@dataclass(frozen=True, eq=False)
class Landmark:
    """A point of the head, in the room: where the match has it, and where mirror images would (n, 3)."""

    name: str
    direction: tuple[float, float, float]
    matched_mm: Array
    mirrored_mm: Array

    @property
    def apart_mm(self) -> float:
        """Distance of the nearest mirror image."""
        return float(np.linalg.norm(self.mirrored_mm - self.matched_mm, axis=1).min())

    @property
    def limit_mm(self) -> float:
        """How far from the match a reading may be: beyond half the distance a mirror image is nearer."""
        return min(READING_LIMIT_MM, 0.5 * self.apart_mm)


def telling_landmark(
    matched: RigidTransform, mirrored: Iterable[RigidTransform], prior: RoomPrior
) -> Landmark | None:
    """The landmark, not on the patient's underside, that best tells a match from its mirror images, if any.

    `mirrored` are the poses physical <- image * MIRROR that fit the same spheres in view of the tracker. Of
    each, the orientations count that the prior does not exclude.
    """
    centre_mm, semi_mm = prior.sight.centre_mm, prior.sight.semi_axes_mm
    poses: list[tuple[Array, Array, Array, bool]] = []
    for pose in mirrored:
        middle_mm = pose.apply(centre_mm * MIRROR)
        for number, mirror in enumerate(MIRRORS):
            rotation = pose.rotation.as_matrix() @ np.diag(MIRROR) @ mirror.T
            if not prior.against_position(rotation, middle_mm):
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
