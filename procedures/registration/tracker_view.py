"""Spheres as the tracker sees them, whose errors are none of the arm's.

Its volumetric accuracy is some tenths of a millimetre, too poor for a registration. A sphere that is a
millimetre off its place in the CT still shows beside the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.target_prediction import residual_information
from ronna_hw.arrays import Array


@dataclass(frozen=True, eq=False)
class TrackerView:
    """Residuals (n, 3) mm of the spheres as seen, and their weight excluding what a pose explains.

    Errors of the CT count as if they were not those of the looks too: they are small beside the tracker's.
    """

    residuals_mm: Array
    weight: Array  # (3n, 3n)

    @classmethod
    def of(cls, image_mm: Array, seen_mm: Array, covariances_mm2: Array, shared_mm: Array) -> Self:
        """Compare spheres (n, 3) mm in the CT with those seen.

        Errors of both, in the frame of what was seen: covariances (n, 3, 3), and displacements (n, 3, k) by
        errors that spheres share.
        """
        fit = fit_rigid(image_mm, seen_mm)
        mapped_mm = image_mm @ fit.rotation.T + fit.translation_mm
        return cls(seen_mm - mapped_mm, residual_information(mapped_mm, covariances_mm2, shared_mm))
