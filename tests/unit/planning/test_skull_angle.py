"""The angle at which a trajectory meets the skull, on shells with a known surface."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.head_in_ct import skull_angle_rad
from procedures.strategies.trajectory import Trajectory

RADIUS_MM, THICK_MM, SKIN_MM = 80.0, 7.0, 5.0


def skull() -> Volume:
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


@pytest.fixture(scope="module")
def volume() -> Volume:
    return skull()


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
