"""A scan that lies on bare bone, where the scalp is open, is registered to it."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.registration.surface.surface_registration import register_surface

SCALP_MM = 5.0
FOREHEAD_MM = np.array([0.0, -85.0, 25.0])
OPENING_MM = 35.0


class Skull:
    """Skull a scalp's thickness below the skin of a made head."""

    def __init__(self, head) -> None:
        self.head = head
        self.points_mm, self.normals = head.points_mm - SCALP_MM * head.normals, head.normals
        self.voxel_mm = head.voxel_mm

    def residuals(self, points_ct_mm):
        distances, normals, valid = self.head.residuals(points_ct_mm)
        return distances + SCALP_MM, normals, valid


def test_bone_that_is_bare_takes_part_in_the_registration(heads, scan_of):
    def is_open(places):
        return np.linalg.norm(places - FOREHEAD_MM, axis=1) < OPENING_MM

    made = scan_of(heads[0], 21, count=300, outwards=lambda places: np.where(is_open(places), -SCALP_MM, 0.0))
    skin_alone = register_surface(made.scan, heads[0], made.start)
    found = register_surface(made.scan, heads[0], made.start, find_bone=lambda: Skull(heads[0]))
    opened = is_open(made.truth.inverse().apply(found.points_mm))
    assert opened.sum() > 20
    assert skin_alone.excluded[opened].mean() > 0.9
    assert found.excluded[opened].mean() < 0.2
    assert np.linalg.norm(made.errors_mm(found.robot_from_ct), axis=1).max() < 0.6


@pytest.mark.parametrize("opening_mm", [55.0, 65.0, 75.0])
def test_much_bare_bone_does_not_tilt_the_head(heads, scan_of, opening_mm):
    def is_open(places):
        return np.linalg.norm(places - FOREHEAD_MM, axis=1) < opening_mm

    made = scan_of(heads[0], 22, count=300, outwards=lambda places: np.where(is_open(places), -SCALP_MM, 0.0))
    found = register_surface(made.scan, heads[0], made.start, find_bone=lambda: Skull(heads[0]))
    assert np.linalg.norm(made.errors_mm(found.robot_from_ct), axis=1).max() < 0.6


def test_the_skull_is_not_looked_for_under_skin_that_is_closed(heads, scan_of):
    made = scan_of(heads[0], 22)
    register_surface(made.scan, heads[0], made.start, find_bone=lambda: pytest.fail("no bone is bare"))


def test_what_is_neither_skin_nor_bone_is_excluded(heads, scan_of):
    def pressed(places):
        return np.where(np.linalg.norm(places - FOREHEAD_MM, axis=1) < 20.0, -9.0, 0.0)

    made = scan_of(heads[0], 23, count=300, outwards=pressed)
    found = register_surface(made.scan, heads[0], made.start, find_bone=lambda: Skull(heads[0]))
    off = np.abs(found.residuals_mm) > 2.0
    assert off.sum() > 5
    assert found.excluded[off].all()
