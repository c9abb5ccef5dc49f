"""The head is found in the CT as one ellipsoid, whatever thin objects are around it."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises

from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.errors import NO_HEAD_IN_CT
from procedures.planning.head_in_ct import fit_head, skull_angle_rad
from procedures.strategies.trajectory import Trajectory

CENTRE_MM = np.array([3.0, -40.0, 810.0])
SEMI_AXES_MM = np.array([75.0, 95.0, 90.0])
SHAPE = (105, 120, 110)
SPACING_MM = np.array([2.0, 2.0, 2.0])


def _volume(solid: np.ndarray) -> Volume:
    voxels = np.where(solid, 40, -1000).astype(np.int16)
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    origin = CENTRE_MM - np.array([SHAPE[2], SHAPE[1], SHAPE[0]]) * 2.0 / 2.0
    return Volume(voxels, VoxelGeometry(SHAPE, origin, axes, SPACING_MM), "1.2.3", "1.2.4")


def _points() -> np.ndarray:
    """Positions of all voxels from the middle of the head, LPS mm, (slices, rows, columns, 3)."""
    slices, rows, columns = np.indices(SHAPE)
    steps = np.stack([columns, rows, slices], axis=-1) * 2.0
    return np.asarray(steps - np.array([SHAPE[2], SHAPE[1], SHAPE[0]]))


def _head(points: np.ndarray) -> np.ndarray:
    return np.asarray(((points / SEMI_AXES_MM) ** 2).sum(axis=-1) <= 1.0)


def test_a_head_is_found_with_things_around_it_with_hollows_and_cropped_by_the_ct() -> None:
    points = _points()
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    post = (np.hypot(x - 10, y + 20) < 6) & (z > 60)
    cable = np.hypot(x + 90, z) < 4
    shell = (y > 100) & (y < 106)
    sinus = np.linalg.norm(points - np.array([0.0, -60.0, 0.0]), axis=-1) < 22
    head = _head(points)
    for solid in (head, head | post | cable | shell, head & ~sinus, head & (z > -55.0)):
        found = fit_head(_volume(solid))
        assert np.allclose(found.centre_mm, CENTRE_MM, atol=3.0)
        assert np.all(np.array(found.semi_axes_mm) >= SEMI_AXES_MM)
        assert np.all(np.array(found.semi_axes_mm) <= SEMI_AXES_MM + 8.0)


def test_a_protruding_chin_lies_within_the_ellipsoid() -> None:
    points = _points()
    chin = np.all(np.abs(points - np.array([0.0, -75.0, -65.0])) < 25, axis=-1)
    solid = _head(points) | chin
    found = fit_head(_volume(solid))
    ways = (np.argwhere(chin) @ np.array([[0, 0, 2.0], [0, 2.0, 0], [2.0, 0, 0]])) - np.array(
        [SHAPE[2], SHAPE[1], SHAPE[0]]
    )
    middle = np.array(found.centre_mm) - CENTRE_MM
    inside = (((ways - middle) / np.array(found.semi_axes_mm)) ** 2).sum(axis=1)
    assert np.quantile(inside, 0.99) <= 1.1  # the very edges are rounded off


def test_air_is_not_taken_for_a_head() -> None:
    with raises(NO_HEAD_IN_CT) as caught:
        fit_head(_volume(np.zeros(SHAPE, dtype=bool)))
    assert caught.value.code == "PLAN-014"


RADIUS_MM, THICK_MM, SKIN_MM = 80.0, 7.0, 5.0


@pytest.fixture(scope="module")
def volume() -> Volume:
    """Air, skin, a shell of bone about the origin, brain."""
    shape = (100, 180, 180)
    geometry = VoxelGeometry(
        shape, np.array([-90.0, -90.0, 0.0]), np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0]]), np.ones(3)
    )
    places = geometry.to_patient_mm(np.moveaxis(np.indices(shape), 0, -1))
    away = np.linalg.norm(places, axis=-1)
    hu = np.select(
        [away > RADIUS_MM + SKIN_MM, away > RADIUS_MM, away > RADIUS_MM - THICK_MM], [-1000, 40, 1200], 35
    )
    return Volume(hu.astype(np.int16), geometry, "1.2", "1.3", "HFS")


@pytest.mark.parametrize("aside_mm", [0.0, 20.0, 40.0, 56.0])
def test_an_off_centre_trajectory_meets_a_ball_at_its_tangent_angle(volume: Volume, aside_mm: float) -> None:
    entry = (aside_mm, 0.0, float(np.sqrt((RADIUS_MM + SKIN_MM) ** 2 - aside_mm**2)))
    way = Trajectory("T1", entry, (aside_mm, 0.0, 10.0))
    expected_deg = 90.0 - np.degrees(np.arcsin(aside_mm / RADIUS_MM))
    angle_rad = skull_angle_rad(volume, way)
    assert angle_rad is not None
    assert np.degrees(angle_rad) == pytest.approx(expected_deg, abs=4.0)  # voxels of 1 mm over a burr hole


def test_an_entry_planned_on_the_bone_gives_the_same_angle(volume: Volume) -> None:
    on_skin = skull_angle_rad(volume, Trajectory("T1", (20.0, 0.0, 82.6), (10.0, 5.0, 10.0)))
    on_bone = skull_angle_rad(volume, Trajectory("T1", (19.3, 0.35, 77.5), (10.0, 5.0, 10.0)))
    assert on_skin is not None
    assert on_bone == pytest.approx(on_skin, abs=np.radians(3.0))


def test_there_is_no_angle_without_bone(volume: Volume) -> None:
    soft = Volume(np.minimum(volume.voxels, np.int16(60)), volume.geometry, "1.2", "1.3", "HFS")
    assert skull_angle_rad(soft, Trajectory("T1", (0.0, 0.0, 85.0), (0.0, 0.0, 10.0))) is None
    assert skull_angle_rad(volume, Trajectory("T1", (0.0, 0.0, 500.0), (0.0, 0.0, 420.0))) is None
