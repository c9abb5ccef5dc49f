"""Lines of sight of the stereo head at the planned poses.

Spheres are compared by their outlines in a camera. Two outlines must not touch, whichever sphere is nearer,
because a bright neighbour behind the rim is as harmful as one in front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from procedures.planning.pose_name import MARKER, SPHERE
from procedures.planning.visits import Unmet, Visit
from ronna_hw.arrays import Array
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.frames import Frame

SPHERE_RADIUS_MM = 5.75
CLEARANCE_MM = 3.0  # around each sphere, for the error of the coarse positions


@dataclass(frozen=True)
class StereoSight:
    """Positions of the two cameras in the tool frame, mm."""

    left_mm: Array
    right_mm: Array

    @classmethod
    def of(cls, calibration: StereoHeadCalibration) -> Self:
        """Derive the camera positions from the stereo head's calibration record."""
        return cls(_projection_centre(calibration.left), _projection_centre(calibration.right))

    def unmet(self, visits: Sequence[Visit], spheres_mm: ArrayLike) -> tuple[Unmet, ...]:
        """List localizations with a neighbour touching the sphere's outline. Spheres (n, 3) are in robot mm.

        Row k of the spheres is the one measured by a visit of `fiducial` k.
        """
        spheres = np.asarray(spheres_mm, dtype=float).reshape(-1, 3)
        found = []
        for visit in visits:
            fiducial = visit.name.fiducial
            if fiducial is None:
                continue
            for name, camera_mm in (("left", self.left_mm), ("right", self.right_mm)):
                neighbour = _find_touching(visit.pose.apply(camera_mm), spheres, fiducial)
                if neighbour is not None:
                    reason, words = (
                        f"{one} {neighbour + 1} is in front of or behind it in the {name} camera"
                        for one in (SPHERE, MARKER)
                    )
                    found.append(Unmet(visit.name, reason, words))
        return tuple(found)


def _projection_centre(camera: CameraCalibration) -> Array:
    """Return the projection centre of either camera in the tool frame."""
    return camera.camera_from_tool.transform(Frame.CAMERA_LEFT, Frame.TOOL).inverse().translation_mm


def _find_touching(camera_mm: Array, spheres_mm: Array, index: int) -> int | None:
    rays = spheres_mm - camera_mm
    distances = np.linalg.norm(rays, axis=1)
    radii = np.arcsin(np.minimum(1.0, (SPHERE_RADIUS_MM + CLEARANCE_MM) / distances))
    cosines = np.clip(rays @ rays[index] / (distances * distances[index]), -1.0, 1.0)
    gaps = np.arccos(cosines) - radii - radii[index]
    gaps[index] = np.inf
    nearest = int(np.argmin(gaps))
    return nearest if gaps[nearest] < 0.0 else None
