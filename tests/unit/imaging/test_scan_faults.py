"""A patient who moves during the scan is detected and refused; one who lies still raises no warning."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from procedures.imaging import read_series
from procedures.imaging.errors import PatientMoved
from procedures.imaging.scan_faults import check_motion
from procedures.imaging.volume import VoxelGeometry

SHAPE = (24, 120, 120)
PIXEL_MM = 1.0
OBLIQUE = (0.6, 0.8)  # a unit vector down the rows and across the columns


def head(
    moved_mm: float,
    slice_mm: float = 1.0,
    seed: int = 0,
    *,
    way: tuple[float, float] = OBLIQUE,
    slid_mm: float = 0.0,
    noise_hu: float = 20.0,
) -> tuple[NDArray[np.int16], VoxelGeometry]:
    """An egg of soft tissue in a skull; from the thirteenth slice on it lies elsewhere."""
    z, y, x = (np.arange(n, dtype=float) for n in SHAPE)
    values = np.empty(SHAPE)
    for number, stated_mm in enumerate(z * slice_mm + 30.0):
        after = number >= SHAPE[0] // 2
        aside = moved_mm / PIXEL_MM if after else 0.0
        height = stated_mm + (slid_mm if after else 0.0)
        off = np.sqrt(
            ((y[:, None] - 59.0 - way[0] * aside) / 45.0) ** 2
            + ((x[None, :] - 60.0 - way[1] * aside) / 38.0) ** 2
            + (height / 60.0) ** 2
        )
        values[number] = np.where(off < 0.9, 40.0, np.where(off < 1.0, 900.0, -1000.0))
        values[number] = gaussian_filter(values[number], 0.8)
    values += noise_hu * np.random.default_rng(seed).standard_normal(SHAPE)
    geometry = VoxelGeometry(SHAPE, np.zeros(3), np.eye(3), np.array([slice_mm, PIXEL_MM, PIXEL_MM]))
    return values.astype(np.int16), geometry


def test_a_small_movement_is_reported_with_its_size_and_location() -> None:
    (warning,) = check_motion(*head(0.7))
    told_mm = float(warning.split("moved by ")[1].split(" mm")[0])
    assert told_mm == pytest.approx(0.7, rel=0.3)
    assert "between slices 12 and 13" in warning


@pytest.mark.parametrize("way", [OBLIQUE, (1.0, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("moved_mm", [1.5, 3.0])
def test_a_movement_by_more_than_a_millimetre_is_refused_with_its_size_and_location(
    moved_mm: float, way: tuple[float, float]
) -> None:
    with pytest.raises(PatientMoved, match="between slices 12 and 13") as refused:
        check_motion(*head(moved_mm, way=way))
    assert refused.value.got is not None
    assert float(refused.value.got.removesuffix(" mm")) == pytest.approx(moved_mm, rel=0.3)
    assert refused.value.limit == "1.0 mm"


def test_a_movement_back_along_the_table_that_repeats_slices_is_refused() -> None:
    with pytest.raises(
        PatientMoved, match=r"back along the table at S .*, between slices 12 and 13"
    ) as refused:
        check_motion(*head(0.0, slid_mm=-3.0))
    assert refused.value.got is not None
    assert float(refused.value.got.removesuffix(" mm")) == pytest.approx(3.0, rel=0.2)


def test_a_movement_shows_in_noisy_slices_of_two_millimetres() -> None:
    with pytest.raises(PatientMoved):
        check_motion(*head(2.0, slice_mm=2.0, noise_hu=50.0))


@pytest.mark.parametrize("seed", range(4))
def test_a_patient_who_lies_still_gives_no_warning(seed: int) -> None:
    assert check_motion(*head(0.0, seed=seed)) == ()
    assert check_motion(*head(0.0, slice_mm=2.0, seed=seed, noise_hu=50.0)) == ()


def test_a_board_that_begins_between_two_slices_empty_and_thick_slices_give_no_motion_warning() -> None:
    voxels, geometry = head(0.0)
    assert check_motion(np.full(SHAPE, -1000, dtype=np.int16), geometry) == ()
    voxels[12:, 8:12, 20:100] = 300  # the board under the head
    assert check_motion(voxels, geometry) == ()
    assert check_motion(*head(3.0, slice_mm=4.0)) == ()


def test_a_series_of_a_patient_who_moved_is_not_read(dicom_series: Callable[..., Path]) -> None:
    voxels, geometry = head(3.0)
    with pytest.raises(PatientMoved):
        read_series(dicom_series(voxels, tuple(geometry.spacing_mm)))
