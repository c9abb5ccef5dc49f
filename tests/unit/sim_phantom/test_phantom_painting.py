"""The CT grid, the painted bodies and the slices: depth, volume, blur, patches, noise and streaks."""

from __future__ import annotations

from dataclasses import replace
from math import erf, sqrt

import numpy as np
import pytest
from coded_errors import raises

from sim.errors import BAD_SCENE
from sim.phantom.head.anatomy import AIR_HU, LAYERS, METAL_HU, Anatomy, HeadLayers, draw_anatomy
from sim.phantom.head.painting import blur_weights, paint
from sim.phantom.head.shapes import Ball, Cable, Ellipsoid, Rod, Trough
from sim.phantom.scan import SlicePainter
from sim.phantom.scanner.grid import CtGrid, place_grid
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import draw_scene

AXIS = np.linspace(-20.0, 20.0, 81, dtype=np.float32)
X, Y, Z = AXIS[None, None, :], AXIS[None, :, None], AXIS[:, None, None]
ORIGIN = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["default", "mini", "bench"])
@pytest.mark.parametrize("seed", range(5))
def test_all_spheres_and_trajectories_lie_in_the_field(name: str, seed: int) -> None:
    scene = draw_scene(name, seed=seed, markers=3 + seed)
    grid = place_grid(scene.head, scene.ct)
    low = np.array([grid.x_mm[0], grid.y_mm[0], grid.z_mm[0]])
    high = np.array([grid.x_mm[-1], grid.y_mm[-1], grid.z_mm[-1]])
    for fiducial in scene.head.fiducials:
        assert (low + 12.0 < fiducial.centre_ct_mm).all()
        assert (high - 12.0 > fiducial.centre_ct_mm).all()
    for target in scene.head.targets:
        assert (low < target.target_ct_mm).all()
        assert (high > target.entry_ct_mm).all()


def test_a_field_that_cannot_hold_the_spheres_is_refused(mini_scene: Scene) -> None:
    with raises(BAD_SCENE, match="do not fit in the CT"):
        place_grid(mini_scene.head, CtProtocol(pixel_mm=0.2, columns=256, rows=256))


def test_indices_select_the_voxels_between_two_coordinates(mini_scene: Scene) -> None:
    grid = place_grid(mini_scene.head, mini_scene.ct)
    inside = grid.indices(2, float(grid.z_mm[10]) - 0.01, float(grid.z_mm[20]) + 0.01)
    assert (inside.start, inside.stop) == (10, 21)
    assert grid.indices(0, -1e6, 1e6) == slice(0, grid.columns)
    nothing = grid.indices(1, 1e6, 2e6)
    assert nothing.start == nothing.stop


@pytest.mark.parametrize(
    ("shape", "inside", "outside"),
    [
        (Ball(1.0, ORIGIN, 5.0), ((0, 0, 0), 5.0), ((8, 0, 0), -3.0)),
        (Rod(1.0, ORIGIN, (0.0, 0.0, 1.0), 10.0, 2.0), ((0, 0, 5), 2.0), ((5, 0, 5), -3.0)),
        (Rod(1.0, ORIGIN, (0.0, 1.0, 0.0), 10.0, 2.0), ((0, 1, 0), 1.0), ((0, 12, 0), -2.0)),
        (Ellipsoid(1.0, ORIGIN, (4.0, 6.0, 8.0)), ((0, 5.5, 0), 0.46), ((0, 0, 8.5), -0.53)),
        (Trough(1.0, ORIGIN, 10.0, 14.0, 0.5), ((0, 12, 3), 2.0), ((0, -12, 3), -18.0)),
        (Cable(1.0, ORIGIN, 2.0, (0.0, 0.0), 50.0), ((0, 0, 90), 2.0), ((5, 0, -90), -3.0)),
    ],
)
def test_depth_is_positive_inside_and_negative_outside(
    shape: Ball, inside: tuple[tuple[float, ...], float], outside: tuple[tuple[float, ...], float]
) -> None:
    for point, depth in (inside, outside):
        x, y, z = (np.array([value], dtype=np.float32) for value in point)
        assert float(shape.depth(x, y, z)[0]) == pytest.approx(depth, abs=0.05)


def test_a_painted_ball_has_the_right_volume_and_centre() -> None:
    image = np.zeros((81, 81, 81), dtype=np.float32)
    paint(image, (AXIS, AXIS, AXIS), Ball(1.0, (1.3, -2.1, 0.7), 8.0), 0.5)
    assert float(image.sum()) * 0.5**3 == pytest.approx(4.0 / 3.0 * np.pi * 8.0**3, rel=2e-3)
    centre = [float((image * axis).sum() / image.sum()) for axis in (X, Y, Z)]
    assert centre == pytest.approx((1.3, -2.1, 0.7), abs=1e-3)


def test_a_body_outside_the_image_paints_nothing() -> None:
    image = np.zeros((81, 81, 81), dtype=np.float32)
    paint(image, (AXIS, AXIS, AXIS), Ball(1.0, (100.0, 0.0, 0.0), 8.0), 0.5)
    assert not image.any()


def test_the_blur_of_an_edge_is_the_error_function_averaged_over_the_voxel() -> None:
    voxels, spacing, sigma = np.arange(-5.0, 5.5, 0.5), 0.5, 0.42
    fine = np.arange(-8.0 + 0.005, 8.0, 0.01)
    got = blur_weights(voxels, spacing, fine, sigma) @ (fine > 0.13).astype(np.float32)
    points = voxels[:, None] + spacing * (np.arange(100)[None, :] + 0.5) / 100 - spacing / 2
    wanted = np.array([[0.5 + 0.5 * erf((p - 0.13) / (sqrt(2) * sigma)) for p in row] for row in points])
    assert got == pytest.approx(wanted.mean(axis=1), abs=2e-3)


def test_weights_add_up_to_one() -> None:
    rows = blur_weights(np.arange(4.0), 1.0, np.arange(-3.0, 7.0, 0.2), 0.42)
    assert rows.sum(axis=1) == pytest.approx(np.ones(4), abs=1e-6)


def test_the_head_has_skin_skull_and_brain_from_outside_in() -> None:
    head = HeadLayers(ORIGIN, (75.0, 95.0, 90.0), 0.0)
    depths = np.array([-3.0, 0.8, 3.0, 7.0, 9.0, 60.0], dtype=np.float32)
    zero = np.zeros(1, dtype=np.float32)
    found = head.hu_at(75.0 - depths, zero, zero).tolist()
    assert found == [AIR_HU, LAYERS[0][1], LAYERS[1][1], LAYERS[3][1], LAYERS[4][1], LAYERS[-1][1]]
    assert head.half_widths(95.0, 3.0) is None
    assert head.half_widths(0.0, 0.0) == pytest.approx((75.0, 95.0))


def test_every_sphere_stands_on_a_post_that_enters_it_and_ends_in_bone(mini_scene: Scene) -> None:
    anatomy = draw_anatomy(mini_scene)
    for marker in anatomy.markers:
        centre, post = np.array(marker.fiducial.centre_ct_mm), np.array(marker.fiducial.post_ct)
        rod, flange = marker.shapes[2], marker.shapes[3]
        for distance, expected in ((4.0, False), (4.5, True), (15.0, True), (25.0, True), (30.0, False)):
            x, y, z = (np.array([value], dtype=np.float32) for value in centre - distance * post)
            assert bool(rod.depth(x, y, z)[0] > 0) is expected
        x, y, z = (np.array([value], dtype=np.float32) for value in centre - 15.3 * post)
        assert flange.depth(x, y, z)[0] > 0.3
        assert 100.0 <= marker.hu <= 150.0


def test_a_post_that_points_away_from_the_head_is_refused(mini_scene: Scene) -> None:
    first = mini_scene.head.fiducials[0]
    wrong = first.model_copy(update={"post_ct": tuple(-value for value in first.post_ct)})
    head = mini_scene.head.model_copy(update={"fiducials": (wrong,)})
    with raises(BAD_SCENE, match="fiducial 1 is not on the head"):
        draw_anatomy(mini_scene.model_copy(update={"head": head}))


def test_five_fillings_sit_in_the_teeth(mini_scene: Scene) -> None:
    anatomy = draw_anatomy(mini_scene)
    assert len(anatomy.fillings) == 5
    grid = place_grid(mini_scene.head, mini_scene.ct)
    assert all(filling.centre[2] > grid.z_mm[0] for filling in anatomy.fillings)


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
