"""Measurement error of single markers in many places, and the measuring volumes."""

from __future__ import annotations

import numpy as np
import pytest

from sim.polaris.measurement.optics import Optics
from sim.polaris.unit.model import EXTENDED_PYRAMID, PYRAMID, SPECTRA, VICRA_VOLUME, UnitVolume
from sim.world.noise import noise
from sim.world.scene.model import TrackerTruth
from sim.world.scene.named_scenes import draw_scene

READINGS = 30  # per place; manufacturers state the mean
PLACES = 1500
STATED_MM = {"Pyramid": 0.25, "Extended Pyramid": 0.30, "Vicra": 0.25}


@pytest.fixture
def truth() -> TrackerTruth:
    return draw_scene("default").tracker


def optics(truth: TrackerTruth, seed: int, *volumes: UnitVolume) -> Optics:
    return Optics(truth, seed, volumes or SPECTRA.volumes)


def places_in(volume: UnitVolume, count: int = PLACES) -> np.ndarray:
    """Points spread evenly over a volume (n, 3)."""
    near, far = volume.depths_mm
    x, y = volume.half_widths_mm(far)
    box = np.random.default_rng(1).uniform((-x, -y, -far), (x, y, -near), (4 * count, 3))
    return np.array([point for point in box if volume.holds(*point)])[:count]


def readings(unit: Optics, points: np.ndarray, count: int) -> np.ndarray:
    """Measurements (count, n, 3) of markers at rest."""
    sight = unit.sight(points)
    return np.array([sight.measured(noise(5, "test", k).standard_normal(points.shape)) for k in range(count)])


def test_a_marker_at_mid_volume_repeats_within_the_published_range(truth: TrackerTruth) -> None:
    middle = np.array([[0.0, 0.0, -PYRAMID.middle_depth_mm]])
    x, y, z = readings(optics(truth, 5), middle, 2000).std(axis=0)[0]
    assert 0.03 <= x <= 0.06
    assert 0.03 <= y <= 0.06
    assert 3.0 <= z / np.hypot(x, y) * np.sqrt(2.0) <= 4.0
    assert [x, y, z] == pytest.approx([truth.noise_xy_mm, truth.noise_xy_mm, truth.noise_z_mm], rel=0.15)


def test_noise_grows_with_the_square_of_the_distance(truth: TrackerTruth) -> None:
    points = np.array([[0.0, 0.0, -depth] for depth in (1000.0, 2000.0)])
    near, far = readings(optics(truth, 5), points, 2000).std(axis=0)
    assert far == pytest.approx(4.0 * near, rel=0.15)


@pytest.mark.parametrize("volume", [PYRAMID, EXTENDED_PYRAMID, VICRA_VOLUME], ids=lambda volume: volume.name)
@pytest.mark.parametrize("seed", [0, 7, 11])
def test_the_rms_error_over_the_whole_volume_matches_the_published_value(
    truth: TrackerTruth, volume: UnitVolume, seed: int
) -> None:
    unit = optics(truth, seed, volume) if volume is VICRA_VOLUME else optics(truth, seed)
    points = places_in(volume)
    errors = readings(unit, points, READINGS).mean(axis=0) - points
    rms_mm = np.sqrt((errors**2).sum(axis=1).mean())
    assert rms_mm == pytest.approx(STATED_MM[volume.name], rel=0.15)


def test_the_systematic_error_is_smooth_and_nearly_constant_across_a_head(truth: TrackerTruth) -> None:
    unit = optics(truth, 5)
    points = places_in(PYRAMID)
    bias = unit.bias_field.error_at(points)
    across_a_head = unit.bias_field.error_at(points + np.array([0.0, 150.0, 0.0])) - bias
    assert np.sqrt((across_a_head**2).sum(axis=1).mean()) < 0.6 * PYRAMID.stated_mm
    beside = unit.bias_field.error_at(points + np.array([10.0, 0.0, 0.0])) - bias
    assert np.linalg.norm(beside, axis=1).max() < 0.1 * PYRAMID.stated_mm


def test_the_systematic_error_is_repeatable_and_differs_between_units(truth: TrackerTruth) -> None:
    points = places_in(PYRAMID, 50)
    assert np.array_equal(optics(truth, 5).sight(points).mean_mm, optics(truth, 5).sight(points).mean_mm)
    assert not np.allclose(optics(truth, 5).sight(points).mean_mm, optics(truth, 6).sight(points).mean_mm)


def test_a_scene_may_have_a_tracker_without_error(truth: TrackerTruth) -> None:
    none = {"noise_xy_mm": 0.0, "noise_z_mm": 0.0, "bias_mm": 0.0, "bias_extended_mm": 0.0}
    points = places_in(PYRAMID, 50)
    assert np.array_equal(readings(optics(truth.model_copy(update=none), 5), points, 1)[0], points)


@pytest.mark.parametrize(
    ("volume", "z", "x", "y"),
    [
        (PYRAMID, -950.0, 224.72, 240.57),
        (PYRAMID, -1532.0, 398.00, 572.00),
        (PYRAMID, -2000.0, 537.34, 685.74),
        (PYRAMID, -2400.0, 656.43, 782.95),
        (EXTENDED_PYRAMID, -2664.0, 735.0, 847.11),
        (EXTENDED_PYRAMID, -3000.0, 735.0, 928.77),
    ],
)
def test_a_volume_has_the_published_cross_sections(volume: UnitVolume, z: float, x: float, y: float) -> None:
    assert volume.holds(x - 0.01, y - 0.01, z)
    assert volume.holds(-x + 0.01, -y + 0.01, z)
    assert not volume.holds(x + 0.01, 0.0, z)
    assert not volume.holds(0.0, -y - 0.01, z)


@pytest.mark.parametrize("z", [-949.9, -2400.1, 1500.0])
def test_no_point_in_front_of_or_behind_the_volume_is_inside(z: float) -> None:
    assert not PYRAMID.holds(0.0, 0.0, z)
