"""Adhesive rings on skin in a CT: found, measured with an honest covariance, and told from other bumps."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from painted_ct import FRAME_UID, SERIES_UID, Scan, Shape

from procedures.imaging import Volume, VoxelGeometry
from procedures.imaging.adhesive import localize_adhesives
from procedures.imaging.errors import ADHESIVE_COUNT_WRONG
from ronna_hw.adhesive_marker import INNER_RADIUS_MM, OUTER_RADIUS_MM, THICKNESS_MM

SKIN = np.array([20.0, 30.0, 30.0])  # slice, row, column, mm
OUTWARD = np.array([0.3, -0.9, 0.2]) / np.linalg.norm([0.3, -0.9, 0.2])
RING_HU, SKIN_HU = 90.0, 40.0


def put_ring(scan: Scan, foot: np.ndarray, *, inner_mm: float = INNER_RADIUS_MM) -> np.ndarray:
    """Lay a ring on the skin and return its centre."""

    def inside(z: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        dz, dy, dx = z - foot[0], y - foot[1], x - foot[2]
        height = dz * OUTWARD[0] + dy * OUTWARD[1] + dx * OUTWARD[2]
        across = np.sqrt(np.maximum(dz**2 + dy**2 + dx**2 - height**2, 0.0))
        wide = np.minimum(across - inner_mm, OUTER_RADIUS_MM - across)
        return np.minimum(wide, np.minimum(height, THICKNESS_MM - height))

    scan.shapes.append(Shape(RING_HU, inside))
    scan.focus.append((foot, 11.0))
    return np.asarray(foot + 0.5 * THICKNESS_MM * OUTWARD)


def volume_of(scan: Scan) -> Volume:
    geometry = VoxelGeometry(scan.shape, np.zeros(3), np.eye(3), np.array(scan.spacing_mm))
    return Volume(scan.voxels(), geometry, SERIES_UID, FRAME_UID)


def skin(seed: int = 1) -> Scan:
    scan = Scan(shape=(40, 120, 120), seed=seed)
    scan.half_space(SKIN, OUTWARD, SKIN_HU)
    return scan


def test_a_ring_is_found_to_within_a_tenth_of_a_millimetre_and_within_its_covariance() -> None:
    scan = skin()
    centre = put_ring(scan, SKIN)
    (ring,) = localize_adhesives(volume_of(scan))
    error = np.array(ring.centre_mm) - centre
    assert np.linalg.norm(error) < 0.1
    assert error @ np.linalg.solve(ring.covariance_mm2, error) < 16.3  # 99.9 % with three degrees
    assert ring.normal == pytest.approx(OUTWARD, abs=0.02)
    assert ring.outer_radius_mm == pytest.approx(OUTER_RADIUS_MM, abs=0.2)
    assert ring.inner_radius_mm == pytest.approx(INNER_RADIUS_MM, abs=0.2)


def test_a_disc_without_a_hole_is_no_ring() -> None:
    scan = skin()
    put_ring(scan, SKIN, inner_mm=-1.0)
    with raises(ADHESIVE_COUNT_WRONG, match=r"CT-026.*0 adhesive rings.*at least one"):
        localize_adhesives(volume_of(scan))


def test_another_number_than_expected_is_refused_with_both() -> None:
    scan = skin()
    put_ring(scan, SKIN)
    with raises(ADHESIVE_COUNT_WRONG, match=r"expected 2.*1"):
        localize_adhesives(volume_of(scan), expected=2)
