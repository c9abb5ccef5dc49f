"""Skin and bone in a CT: where they are below a voxel, and what is no surface."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from scipy.ndimage import gaussian_filter

from procedures.imaging.ct_surface import Reason, find_bone, find_skin
from procedures.imaging.errors import NO_SURFACE
from procedures.imaging.volume import Volume, VoxelGeometry

RADIUS_MM = 40.0
SKULL_MM = 6.0  # below the skin
CENTRE_MM = np.array([3.0, -4.0, 100.0])
BLUR_MM = 0.7


def painted(spacing_mm, *, turned=False, headrest=False, cable=False, mouth=False, hair=False) -> Volume:
    """CT of a ball of soft tissue with a skull, its edges blurred as by a scanner, with noise."""
    spacing = np.asarray(spacing_mm)
    shape = tuple(np.ceil(108.0 / spacing).astype(int).tolist())
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # slices along z, rows y, columns x
    if turned:
        axes = axes @ np.diag([1.0, -1.0, -1.0])
    origin = CENTRE_MM - axes @ (0.5 * (np.array(shape) - 1.0) * spacing)
    geometry = VoxelGeometry(shape, origin, axes, spacing)
    fine = np.stack(np.meshgrid(*(np.arange(size) for size in shape), indexing="ij"), axis=-1)
    x, y, z = np.moveaxis(geometry.to_patient_mm(fine) - CENTRE_MM, -1, 0)
    from_centre = np.sqrt(x**2 + y**2 + z**2)

    def edge(distance, step):
        from scipy.special import ndtr

        return step * ndtr(distance / BLUR_MM)

    hu = -1000.0 + edge(RADIUS_MM - from_centre, 1040.0) + edge(RADIUS_MM - SKULL_MM - from_centre, 1000.0)
    added = np.full(shape, -1000.0)
    if headrest:
        added[(y > 38.0) & (y < 47.0) & (np.abs(x) < 30.0)] = -600.0
    if cable:
        added[(np.hypot(x - 47.0, y) < 2.0)] = 280.0
    if hair:
        added[(from_centre > RADIUS_MM) & (from_centre < RADIUS_MM + 5.0) & (z > 25.0)] = -780.0
    hu = np.maximum(hu, gaussian_filter(added, BLUR_MM / spacing))
    if mouth:
        hole = (np.hypot(x, z) < 2.5) & (y < -20.0) | (np.hypot(np.hypot(x, z), y + 22.0) < 9.0)
        hu = np.where(hole, -1000.0, hu)
    hu = hu + np.random.default_rng(2).normal(size=shape) * 12.0
    return Volume(np.rint(hu).astype(np.int16), geometry, "1.2", "1.3")


def on_ball(radius_mm, count=400):
    directions = np.random.default_rng(3).normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return CENTRE_MM + radius_mm * directions, directions


@pytest.mark.parametrize("spacing_mm", [(1.0, 0.8, 0.8), (2.0, 0.7, 0.7)])
def test_the_skin_is_found_below_a_voxel(spacing_mm):
    skin = find_skin(painted(spacing_mm, turned=True))
    places, outwards = on_ball(RADIUS_MM)
    for away_mm in (-0.8, 0.0, 3.0):
        distance, normal, valid = skin.residuals(places + away_mm * outwards)
        assert valid.mean() > 0.97
        assert np.median(distance[valid]) - away_mm == pytest.approx(0.0, abs=0.06)
        assert np.std(distance[valid]) < 0.08
        assert np.einsum("ni,ni->n", normal, outwards)[valid].min() > 0.97


def test_bone_lies_below_the_skin():
    bone = find_bone(painted((1.0, 0.8, 0.8)))
    distance, _, valid = bone.residuals(on_ball(RADIUS_MM - SKULL_MM)[0])
    assert valid.mean() > 0.97
    assert np.median(distance[valid]) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize(
    ("around", "place", "reason"),
    [
        ({"headrest": True}, [0.0, 40.0, 0.0], Reason.COVERED),
        ({"hair": True}, [0.0, 0.0, 40.0], Reason.COVERED),
    ],
)
def test_skin_against_something_is_excluded_with_its_reason(around, place, reason):
    skin = find_skin(painted((1.0, 0.8, 0.8), **around))
    assert reason in {one.reason for one in skin.excluded}
    _, _, valid = skin.residuals(CENTRE_MM + np.array([place, [40.0, 0.0, 0.0]]))
    assert valid.tolist() == [False, True]


def test_a_cable_is_another_body_and_the_mouth_is_inside():
    skin = find_skin(painted((1.0, 0.8, 0.8), cable=True, mouth=True))
    assert np.linalg.norm(skin.points_mm - CENTRE_MM, axis=1).min() > RADIUS_MM - 6.0
    assert np.linalg.norm(skin.points_mm - CENTRE_MM, axis=1).max() < RADIUS_MM + 1.0


def test_the_edge_of_the_scan_is_no_skin():
    whole = painted((1.0, 0.8, 0.8))
    cut = VoxelGeometry(
        (70, *whole.geometry.shape[1:]),
        whole.geometry.origin_mm,
        whole.geometry.axes,
        whole.geometry.spacing_mm,
    )
    skin = find_skin(Volume(whole.voxels[:70], cut, "1.2", "1.3"))
    assert Reason.EDGE in {one.reason for one in skin.excluded}
    face_mm = cut.to_patient_mm([69.0, 0.0, 0.0])[2]
    assert skin.points_mm[:, 2].max() < face_mm - 3.0


def test_a_ct_without_a_head_is_refused():
    empty = painted((4.0, 4.0, 4.0))
    with raises(NO_SURFACE):
        find_skin(Volume(np.full_like(empty.voxels, -1000), empty.geometry, "1.2", "1.3"))
    with raises(NO_SURFACE):
        find_bone(Volume(np.full_like(empty.voxels, 40), empty.geometry, "1.2", "1.3"))
