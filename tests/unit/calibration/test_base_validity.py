"""Shift of a platform since the bases were measured, as the tracker shows it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.base_validity import MOVED_MM, platform_shift
from procedures.calibration.errors import DegeneratePoses

Array = NDArray[np.float64]

MASTER_MM = np.array([(0.0, 0.0, -1800.0), (250.0, 30.0, -1900.0), (40.0, 260.0, -1850.0)])
ASSISTANT_MM = MASTER_MM + np.array((150.0, -200.0, 50.0))


def seen(places_mm: Array) -> Array:
    """The places as a tracker sees them that was moved meanwhile."""
    return np.asarray(Rotation.from_rotvec((0.02, -0.05, 0.03)).apply(places_mm)) + np.array(
        (12.0, -30.0, 8.0)
    )


def test_a_moved_tracker_is_no_moved_platform() -> None:
    assert platform_shift(MASTER_MM, seen(MASTER_MM), ASSISTANT_MM, seen(ASSISTANT_MM)).shift_mm < 1e-6


@pytest.mark.parametrize("by_mm", [(0.21, 0.0, 0.0), (0.0, -0.13, 0.17)])
def test_a_platform_that_moved_by_a_fifth_of_a_millimetre_shows(by_mm: tuple[float, float, float]) -> None:
    shift = platform_shift(MASTER_MM, seen(MASTER_MM), ASSISTANT_MM, seen(ASSISTANT_MM + by_mm))
    assert MOVED_MM < shift.shift_mm == pytest.approx(np.linalg.norm(by_mm))


def test_the_stated_error_of_a_shift_is_the_one_found() -> None:
    draws, shifts, sigma_mm = np.random.default_rng(4), [], 0.02
    for _ in range(400):
        noisy = [places + draws.normal(0.0, sigma_mm, places.shape) for places in (MASTER_MM,) * 2]
        other = [places + draws.normal(0.0, sigma_mm, places.shape) for places in (ASSISTANT_MM[:1],) * 2]
        found = platform_shift(noisy[0], noisy[1], other[0], other[1], sigma_mm)
        shifts.append(found.shift_mm)
    assert np.sqrt(np.mean(np.square(shifts))) == pytest.approx(found.error_mm, rel=0.1)


def test_references_on_one_line_show_nothing() -> None:
    line_mm = MASTER_MM[0] + np.outer((0.0, 1.0, 2.0), (100.0, 0.0, 0.0))
    with pytest.raises(DegeneratePoses):
        platform_shift(line_mm, line_mm, ASSISTANT_MM, ASSISTANT_MM)
