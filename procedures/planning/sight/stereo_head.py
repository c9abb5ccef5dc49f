"""Do both cameras of the stereo head see every sphere, or is another sphere in the way?

Spheres are compared by their outlines as seen from a camera: two outlines must not touch, whichever sphere is
nearer, because a bright neighbour behind the rim is as harmful as one in front.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.planning.path_check.visits import Unmet, Visit, VisitKind
from ronna_hw.calibration import CameraCalibration, StereoHeadCalibration
from ronna_hw.frames import Frame

Array = NDArray[np.float64]

SPHERE_RADIUS_MM = 5.75
CLEARANCE_MM = 3.0  # around each sphere, for the error of the coarse positions


@dataclass(frozen=True)
class StereoSight:
    """Positions of the two cameras in the tool frame, mm."""

    left_mm: Array
    right_mm: Array

    @classmethod
    def of(cls, calibration: StereoHeadCalibration) -> Self:
        """From the calibration record of the stereo head."""
        return cls(_centre(calibration.left), _centre(calibration.right))

    def unmet(self, visits: Sequence[Visit], spheres_mm: ArrayLike) -> tuple[Unmet, ...]:
        """Localizations in which a neighbour touches the sphere's outline; spheres (n, 3) in robot mm.

        Row k of the spheres is the one measured by a visit with `fiducial` k.
        """
        spheres = np.asarray(spheres_mm, dtype=float).reshape(-1, 3)
        found = []
        for visit in visits:
            if visit.kind is not VisitKind.LOCALIZATION or visit.fiducial is None:
                continue
            for name, camera_mm in (("left", self.left_mm), ("right", self.right_mm)):
                neighbour = _touching(visit.pose.apply(camera_mm), spheres, visit.fiducial)
                if neighbour is not None:
                    reason = f"sphere {neighbour + 1} is in front of or behind it in the {name} camera"
                    found.append(Unmet(visit.identifier, reason))
        return tuple(found)


def _centre(camera: CameraCalibration) -> Array:
    """Centre of projection in the tool frame; either camera's frame name will do."""
    return camera.camera_from_tool.transform(Frame.CAMERA_LEFT, Frame.TOOL).inverse().translation_mm


def _touching(camera_mm: Array, spheres_mm: Array, looked_at: int) -> int | None:
    rays = spheres_mm - camera_mm
    distances = np.linalg.norm(rays, axis=1)
    radii = np.arcsin(np.minimum(1.0, (SPHERE_RADIUS_MM + CLEARANCE_MM) / distances))
    cosines = np.clip(rays @ rays[looked_at] / (distances * distances[looked_at]), -1.0, 1.0)
    gaps = np.arccos(cosines) - radii - radii[looked_at]
    gaps[looked_at] = np.inf
    nearest = int(np.argmin(gaps))
    return nearest if gaps[nearest] < 0.0 else None
