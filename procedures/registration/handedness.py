"""Whether a mirrored image would explain the room as well, and which point of the head tells them apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from procedures.registration.room_prior import MIRROR, RoomPrior

Array = NDArray[np.float64]

_SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
# How a stored image becomes its mirror image: columns, rows or slices reversed, rows and columns swapped, the
# same with both reversed, all three reversed.
MIRRORS = (
    *(np.diag(signs) for signs in ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, -1.0))),
    _SWAPPED,
    _SWAPPED @ np.diag([-1.0, -1.0, 1.0]),
    -np.eye(3),
)
LANDMARKS = {  # points of a head that a person finds and can touch: directions from its centre, LPS
    "crown of the head": (0.0, 0.0, 1.0),
    "tip of the nose": (0.0, -1.0, 0.0),
    "back of the head": (0.0, 1.0, 0.0),
    "left ear": (1.0, 0.0, 0.0),
    "right ear": (-1.0, 0.0, 0.0),
}
LEAST_APART_MM = 15.0  # between the landmark as matched and as mirrored, for a reading to tell them apart
READING_LIMIT_MM = 40.0  # a head is an ellipsoid only roughly


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
    poses: list[tuple[Array, Array, Array]] = [
        (matched.rotation.as_matrix(), matched.apply(centre_mm), semi_mm)
    ]
    for pose in mirrored:
        middle_mm = pose.apply(centre_mm * MIRROR)
        for mirror in MIRRORS:
            rotation = pose.rotation.as_matrix() @ np.diag(MIRROR) @ mirror.T
            if not prior.against_position(rotation, middle_mm):
                poses.append((rotation, middle_mm, np.abs(mirror) @ semi_mm))
    if len(poses) == 1:
        return None
    candidates = []
    for name, direction in LANDMARKS.items():
        first, *others = (middle + turned @ (semi * direction) for turned, middle, semi in poses)
        if prior.lying_up @ direction >= 0.0:
            candidates.append(Landmark(name, direction, first, np.array(others)))
    return max(candidates, key=lambda one: one.apart_mm)
