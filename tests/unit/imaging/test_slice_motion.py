"""A patient who moves during the scan is detected; one who lies still raises no warning."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from procedures.imaging.slice_motion import motion_warnings
from procedures.imaging.volume import VoxelGeometry

SHAPE = (24, 120, 120)
PIXEL_MM = 1.0


def head(moved_mm: float, slice_mm: float = 1.0, seed: int = 0) -> tuple[NDArray[np.int16], VoxelGeometry]:
    """An egg of soft tissue in a skull; from the thirteenth slice on it lies to the side."""
    z, y, x = (np.arange(n, dtype=float) for n in SHAPE)
    values = np.empty(SHAPE)
    for number, height in enumerate(z * slice_mm - 0.5 * SHAPE[0] * slice_mm):
        aside = moved_mm / PIXEL_MM if number >= SHAPE[0] // 2 else 0.0
        off = np.sqrt(
            ((y[:, None] - 59.0 - 0.6 * aside) / 45.0) ** 2
            + ((x[None, :] - 60.0 - 0.8 * aside) / 38.0) ** 2
            + (height / 60.0) ** 2
        )
        values[number] = np.where(off < 0.9, 40.0, np.where(off < 1.0, 900.0, -1000.0))
        values[number] = gaussian_filter(values[number], 0.8)
    values += 20.0 * np.random.default_rng(seed).standard_normal(SHAPE)
    geometry = VoxelGeometry(SHAPE, np.zeros(3), np.eye(3), np.array([slice_mm, PIXEL_MM, PIXEL_MM]))
    return values.astype(np.int16), geometry


@pytest.mark.parametrize("moved_mm", [1.0, 3.0])
def test_a_movement_is_reported_with_its_size_and_location(moved_mm: float) -> None:
    (warning,) = motion_warnings(*head(moved_mm))
    told_mm = float(warning.split("moved by ")[1].split(" mm")[0])
    assert told_mm == pytest.approx(moved_mm, rel=0.3)
    assert "between slices 12 and 13" in warning


@pytest.mark.parametrize("seed", range(4))
def test_a_patient_who_lies_still_gives_no_warning(seed: int) -> None:
    assert motion_warnings(*head(0.0, seed=seed)) == ()


def test_thick_slices_give_no_motion_warning() -> None:
    assert motion_warnings(*head(3.0, slice_mm=4.0)) == ()
