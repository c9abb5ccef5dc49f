"""Beam hardening: dense bodies absorb the soft part of the beam, so what is in line with them is too dark.

The slice is projected as parallel beams through a coarse copy of it. The loss from hardening is modelled as
proportional to the path through dense matter times the total path, the leading term for a scanner with water
correction. The error of the projections is reconstructed by filtered back-projection and added.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sim.phantom.head.shapes import Values

COARSE_MM = 1.5
ANGLES = 120
DENSE_FROM_HU = 300.0  # above soft tissue and water
LOSS_PER_CM = (
    0.012  # of the total path, per cm of dense matter (water equivalent); a skull then cups by 30 to 60 HU
)
MM_PER_CM = 10.0
HU_PER_WATER = 1000.0


def hardening(image: Values, pixel_mm: float, strength: float) -> Values:
    """Correction to add to a slice (rows, columns) in HU; a `strength` of 1 is typical."""
    import cv2

    step = max(1, round(COARSE_MM / pixel_mm))
    rows, columns = (-(-size // step) for size in image.shape)
    side = int(np.ceil(np.hypot(rows, columns)))
    coarse = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
    water = np.zeros((side, side), dtype=np.float32)
    top, left = (side - rows) // 2, (side - columns) // 2
    water[top : top + rows, left : left + columns] = np.maximum(coarse / HU_PER_WATER + 1.0, 0.0)
    dense = np.where(water > 1.0 + DENSE_FROM_HU / HU_PER_WATER, water - 1.0, np.float32(0.0))
    if not dense.any():
        return np.zeros_like(image)
    cell_cm = step * pixel_mm / MM_PER_CM
    error = np.zeros_like(water)
    loss = np.float32(-strength * LOSS_PER_CM)
    for turn, back in _turns(side):
        whole = cv2.warpAffine(water, turn, (side, side)).sum(axis=0) * cell_cm
        through = cv2.warpAffine(dense, turn, (side, side)).sum(axis=0) * cell_cm
        filtered = _ramp_filtered(loss * through * whole, cell_cm)
        smeared = np.broadcast_to(filtered.astype(np.float32), (side, side))
        error += cv2.warpAffine(np.ascontiguousarray(smeared), back, (side, side))
    error *= np.float32(np.pi / ANGLES * HU_PER_WATER)
    shown = error[top : top + rows, left : left + columns]
    return np.asarray(cv2.resize(shown, image.shape[::-1], interpolation=cv2.INTER_LINEAR))


@lru_cache(maxsize=2)
def _turns(side: int) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    import cv2

    middle = ((side - 1) / 2.0, (side - 1) / 2.0)
    angles = [180.0 * number / ANGLES for number in range(ANGLES)]
    return tuple(
        (cv2.getRotationMatrix2D(middle, angle, 1.0), cv2.getRotationMatrix2D(middle, -angle, 1.0))
        for angle in angles
    )


def _ramp_filtered(projection: Values, cell_cm: float) -> Values:
    """Ramp-filtered with cosine roll-off (Shepp-Logan would ring at a post)."""
    count = 2 * len(projection)
    cycles = np.fft.rfftfreq(count, cell_cm)
    roll = np.cos(0.5 * np.pi * cycles / cycles[-1])
    return np.asarray(np.fft.irfft(np.fft.rfft(projection, count) * cycles * roll, count)[: len(projection)])
