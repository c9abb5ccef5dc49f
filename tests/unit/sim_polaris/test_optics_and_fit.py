"""The measurement volume, and the fit of a rigid body to its markers."""

from __future__ import annotations

import numpy as np
import pytest

from sim.polaris.measurement.tracking_rules import fit_rigid_body
from sim.polaris.unit.model import EXTENDED_PYRAMID, PYRAMID, Volume
from sim.world.rigid import rotation_from_vector


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
def test_a_volume_has_the_published_cross_sections(volume: Volume, z: float, x: float, y: float) -> None:
    assert volume.holds(x - 0.01, y - 0.01, z)
    assert volume.holds(-x + 0.01, -y + 0.01, z)
    assert not volume.holds(x + 0.01, 0.0, z)
    assert not volume.holds(0.0, -y - 0.01, z)


@pytest.mark.parametrize("z", [-949.9, -2400.1, 1500.0])
def test_no_point_in_front_of_or_behind_the_volume_is_inside(z: float) -> None:
    assert not PYRAMID.holds(0.0, 0.0, z)


def test_a_fit_recovers_the_original_pose() -> None:
    generator = np.random.default_rng(11)
    for _ in range(50):
        body = generator.uniform(-80.0, 80.0, (4, 3))
        rotation = rotation_from_vector(generator.uniform(-2.0, 2.0, 3))
        shift = generator.uniform(-500.0, 500.0, 3)
        found = fit_rigid_body(body, body @ rotation.T + shift)
        assert np.allclose(found[0], rotation, atol=1e-9)
        assert np.allclose(found[1], shift, atol=1e-7)
        assert found[2].max() < 1e-9


def test_a_mirror_image_is_never_fitted() -> None:
    body = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 90.0, 0.0], [10.0, 20.0, 40.0]])
    rotation, _, distances = fit_rigid_body(body, body * (1.0, 1.0, -1.0))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert distances.max() > 5.0


def test_a_planar_body_is_fitted_without_a_flip() -> None:
    body = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 90.0, 0.0], [-44.0, 40.0, 0.0]])
    rotation, _, distances = fit_rigid_body(body, body + np.random.default_rng(3).normal(0.0, 0.1, (4, 3)))
    assert np.linalg.norm(rotation - np.eye(3)) < 0.02
    assert distances.max() < 0.5
