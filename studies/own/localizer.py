"""A user's localizer, with its answer checked: points in mm within the scanned volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.errors import MarkerCountWrong
from procedures.imaging.volume import Volume
from studies.own.calling import OwnCallable, called
from studies.own.numbers import real_numbers

Array = NDArray[np.float64]

BESIDE_MM = 10.0  # outside the volume: the centre of a sphere cut by the field of view


class OwnLocalizer(OwnCallable):
    """Called like `Localizer`; raises STU-013 and STU-014."""

    result = "centres"
    form = "numbers (n, 3): patient coordinates LPS in mm, as returned by volume.geometry.to_patient_mm"

    def __call__(self, volume: Volume) -> Array:
        """Centres (n, 3), LPS mm."""
        try:
            answer = called(self.name, self.function, volume, passed=(MarkerCountWrong,))
        except MarkerCountWrong:  # how our localizer says that there are none
            return np.empty((0, 3))
        try:
            centres_mm = real_numbers(answer)
        except ValueError as error:
            raise self._wrong(str(error)) from None
        if centres_mm.size == 0:
            return np.empty((0, 3))
        if centres_mm.ndim != 2 or centres_mm.shape[1] != 3:
            raise self._wrong(f"shape {centres_mm.shape}")
        if not np.isfinite(centres_mm).all():
            raise self._wrong("numbers that are not finite")
        geometry = volume.geometry
        beyond = np.abs(geometry.to_index(centres_mm) * geometry.spacing_mm - 0.5 * volume.extent_mm)
        outside = (beyond > 0.5 * volume.extent_mm + BESIDE_MM).any(axis=1)
        if outside.any():
            shown = ", ".join(f"{value:.1f}" for value in centres_mm[outside][0])
            raise self._wrong(f"({shown}), which is outside the volume: voxel indices?")
        return centres_mm
