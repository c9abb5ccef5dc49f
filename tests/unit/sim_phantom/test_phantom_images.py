"""The painted scan: sphere positions, noise as specified, and reproducibility by seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.phantom.head.anatomy import METAL_HU, Anatomy, draw_anatomy
from sim.phantom.scan import SlicePainter
from sim.phantom.scanner.grid import CtGrid, place_grid
from sim.world.scene.model import Scene


def painter_of(scene: Scene) -> tuple[SlicePainter, CtGrid, Anatomy]:
    grid, anatomy = place_grid(scene.head, scene.ct), draw_anatomy(scene)
    painter = SlicePainter(scene, grid, anatomy)
    painter.patches = tuple(painter.paint_patch(k) for k in range(len(anatomy.markers)))
    return painter, grid, anatomy


def bare(scene: Scene) -> Anatomy:
    """The anatomy with spheres alone, without posts, film and flange."""
    anatomy = draw_anatomy(scene)
    markers = tuple(
        type(marker)(marker.fiducial, marker.hu, marker.post, marker.shapes[1:2])
        for marker in anatomy.markers
    )
    return Anatomy((), (), markers, ())


def test_a_sphere_is_within_a_few_micrometres_of_its_place_in_the_scene(mini_scene: Scene) -> None:
    grid, anatomy = place_grid(mini_scene.head, mini_scene.ct), bare(mini_scene)
    painter = SlicePainter(mini_scene, grid, anatomy)
    for number, marker in enumerate(anatomy.markers):
        patch = painter.paint_patch(number)
        weight = patch.hu.astype(float) + 1000.0
        x = grid.x_mm[patch.columns][None, None, :]
        y = grid.y_mm[patch.rows][None, :, None]
        z = grid.z_mm[patch.slices][:, None, None]
        near = np.sqrt(
            sum((a - c) ** 2 for a, c in zip((x, y, z), marker.fiducial.centre_ct_mm, strict=True))
        )
        weight[near > 9.0] = 0.0
        assert weight.sum() * 1.5 == pytest.approx(4 / 3 * np.pi * 5.75**3 * (marker.hu + 1000.0), rel=3e-3)
        centre = [float((weight * axis).sum() / weight.sum()) for axis in (x, y, z)]
        assert centre == pytest.approx(marker.fiducial.centre_ct_mm, abs=0.005)


def test_patches_join_the_rest_of_the_slice_without_a_step(mini_scene: Scene) -> None:
    painter, _, anatomy = painter_of(mini_scene)
    patches, painter.patches = painter.patches, ()
    for patch in patches:
        number = (patch.slices.start + patch.slices.stop) // 2
        around = painter.clean(number)[patch.rows, patch.columns]
        inside = patch.hu[number - patch.slices.start]
        edge = np.ones(inside.shape, dtype=bool)
        edge[1:-1, 1:-1] = False
        assert np.abs(inside - around)[edge].mean() < 25.0
    assert anatomy.markers


def test_noise_has_the_specified_level_and_is_correlated_only_within_the_slice(mini_scene: Scene) -> None:
    painter, _, _ = painter_of(mini_scene)
    first, second = painter.noise(40), painter.noise(41)
    assert first.std() == pytest.approx(mini_scene.ct.noise_HU, rel=0.02)
    neighbours = np.corrcoef(first[:, 1:].ravel(), first[:, :-1].ravel())[0, 1]
    assert 0.05 < neighbours < 0.3  # at 1 mm pixels; more at smaller ones
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.02


def test_a_slice_depends_on_the_seed_and_not_on_the_order_of_painting(mini_scene: Scene) -> None:
    painter, _, _ = painter_of(mini_scene)
    once = painter.clean(100), painter.noise(100)
    painter.clean(20)
    painter.noise(20)
    assert np.array_equal((painter.clean(100), painter.noise(100)), once)
    other, _, _ = painter_of(mini_scene.model_copy(update={"seed": 4}))
    assert not np.array_equal(other.noise(100), once[1])


def test_metal_makes_streaks_in_its_own_slices_only(mini_scene: Scene) -> None:
    grid, anatomy = place_grid(mini_scene.head, mini_scene.ct), draw_anatomy(mini_scene)
    painter = SlicePainter(mini_scene, grid, anatomy)
    without = SlicePainter(mini_scene, grid, replace(anatomy, fillings=()))
    assert all(filling.hu == METAL_HU for filling in anatomy.fillings)
    level = int(np.argmin(np.abs(grid.z_mm - anatomy.fillings[0].centre[2])))
    streaks = painter.clean(level) - without.clean(level)
    assert streaks.max() > 150.0
    assert streaks.min() < -150.0
    assert np.abs(streaks[:20]).max() < 150.0  # far from the teeth they have faded
    assert np.array_equal(painter.clean(level + 12), without.clean(level + 12))
