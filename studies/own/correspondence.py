"""A user's correspondence method, with its answer checked: each point in at most one pair."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from studies.own.calling import OwnCallable, called

Array = NDArray[np.float64]
Pairs = NDArray[np.intp]


class OwnPairing(OwnCallable):
    """Called like `Pairing`; raises STU-013 and STU-014."""

    result = "a pairing"
    form = "None, or whole numbers (k, 2): indices from 0 of image and physical points, each point once"

    def __call__(
        self, image_mm: Array, physical_mm: Array, *, sigma_image_mm: float, sigma_physical_mm: float
    ) -> Pairs | None:
        """Pairs (k, 2); None without a unique answer."""
        answer = called(
            self.name,
            self.function,
            image_mm,
            physical_mm,
            sigma_image_mm=sigma_image_mm,
            sigma_physical_mm=sigma_physical_mm,
        )
        if answer is None:
            return None
        try:
            pairs = np.asarray(answer)
        except ValueError:  # rows of unequal length
            pairs = np.asarray(None)
        if pairs.size == 0 and pairs.dtype != object:
            return np.empty((0, 2), dtype=np.intp)
        if pairs.dtype.kind not in "iu" or pairs.ndim != 2 or pairs.shape[1] != 2:
            raise self._wrong(f"{type(answer).__name__} of {pairs.dtype}, shape {pairs.shape}")
        for side, points in enumerate((image_mm, physical_mm)):
            of_side = pairs[:, side]
            if of_side.min() < 0 or of_side.max() >= len(points):
                raise self._wrong(f"index {of_side.max()} of {len(points)} points")
            if len(set(of_side.tolist())) < len(of_side):
                raise self._wrong("a point in two pairs")
        return pairs.astype(np.intp)
