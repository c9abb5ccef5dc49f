"""Spheres of a registration in projections of the CT: where they are expected, and which way they are off."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from procedures.imaging.sphere_projection import (
    EXPECTED_BGR,
    FOUND_BGR,
    MAGNIFIED,
    PIXELS,
    STEP_MM,
    project_spheres,
)
from procedures.imaging.volume import Volume, VoxelGeometry

EXPECTED_MM = np.array([(-40.0, 0.0, 0.0), (40.0, 30.0, 20.0), (0.0, -30.0, 40.0)])
OFF_MM = 0.2  # to the left of the patient: to the right in axial and coronal planes
BRIGHT = 100


def planes(volume: Volume | None, found_mm: np.ndarray) -> list[np.ndarray]:
    """The three planes as BGR."""
    drawn = project_spheres(volume, EXPECTED_MM, found_mm, ("M1", "M2", "M3"))
    picture = np.asarray(Image.open(io.BytesIO(drawn)))[:, :, ::-1]
    return np.array_split(picture, 3, axis=1)


def columns_of(plane: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    return np.nonzero((np.abs(plane.astype(int) - colour).max(axis=2) < 40).any(axis=0))[0]


def test_an_arrow_shows_the_deviation_magnified_and_on_the_right_side() -> None:
    found_mm = np.full_like(EXPECTED_MM, np.nan)
    found_mm[0] = EXPECTED_MM[0] + (OFF_MM, 0.0, 0.0)
    axial, coronal, sagittal = planes(None, found_mm)
    long_px = OFF_MM * MAGNIFIED / STEP_MM * PIXELS
    for plane in (axial, coronal):
        arrow = columns_of(plane, FOUND_BGR)
        assert abs(np.ptp(arrow) - long_px) < 6
        ring = columns_of(plane, EXPECTED_BGR)
        assert arrow.max() > ring.min() + long_px  # M1 is the outermost on the right of the patient
    assert np.ptp(columns_of(sagittal, FOUND_BGR)) < 12  # seen along it


def test_the_ct_is_behind_its_spheres_and_without_it_the_picture_is_drawn_all_the_same() -> None:
    voxels = np.full((60, 60, 60), -1000, np.int16)
    voxels[30, 30, 10] = 3000  # at L -40, P 0, S 0: where M1 is
    geometry = VoxelGeometry(voxels.shape, np.full(3, -60.0), np.fliplr(np.eye(3)), np.full(3, 2.0))
    nowhere = np.full_like(EXPECTED_MM, np.nan)
    with_ct, without = planes(Volume(voxels, geometry, "1.2", "1.3"), nowhere), planes(None, nowhere)
    for seen, black in zip(with_ct, without, strict=True):
        ring = np.argwhere(np.abs(black.astype(int) - EXPECTED_BGR).max(axis=2) < 40)
        assert len(ring)
        brighter = np.argwhere((seen.astype(int) - black).min(axis=2) > BRIGHT)
        assert len(brighter)
        assert min(np.linalg.norm(ring - one, axis=1).min() for one in brighter) < 8.0 / STEP_MM * PIXELS
