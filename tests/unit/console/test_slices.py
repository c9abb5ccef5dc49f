"""CT cut pictures: the patient's left, back and top appear on the sides that carry their letters."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from console.planning.pictures import UNSCANNED_GREY, UNSCANNED_HU, render_png, sample_cut_hu
from console.planning.slice_panel import side_letters
from console.planning.slices import DIRECTIONS, SIZE_PX, Cut, Plane
from procedures.imaging.volume import Volume, VoxelGeometry

SHAPE = (30, 60, 50)  # slices, rows, columns
SPACING_MM = np.array([2.0, 1.0, 1.5])
UPWARDS = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # slices go up, columns left
TURNED = UPWARDS @ np.diag([-1.0, 1.0, -1.0])  # slices go down, columns right
MARK_MM = np.array([20.0, 9.0, 13.0])  # on the left, at the back, above the middle


def volume(axes: np.ndarray = UPWARDS) -> Volume:
    extent = axes @ (SPACING_MM * (np.array(SHAPE) - 1) / 2.0)
    geometry = VoxelGeometry(SHAPE, -extent, axes, SPACING_MM)
    places = geometry.to_patient_mm(np.moveaxis(np.indices(SHAPE), 0, -1))
    return Volume(
        (1000 * np.exp(-(((places - MARK_MM) / 5.0) ** 2).sum(axis=-1))).astype(np.int16),
        geometry,
        "1.2",
        "1.3",
    )


def picture(plane: Plane, at_mm: np.ndarray) -> Cut:
    right, down = (np.array(one) for one in DIRECTIONS[plane])
    return Cut(at_mm, right, down, 0.4)


def shown_grey(cut: Cut, window_hu: tuple[float, float]) -> np.ndarray:
    picture = np.frombuffer(render_png(volume(), cut, window_hu), np.uint8)
    return cv2.imdecode(picture, cv2.IMREAD_GRAYSCALE)


@pytest.mark.parametrize("axes", [UPWARDS, TURNED])
@pytest.mark.parametrize("plane", list(DIRECTIONS))
def test_a_mark_appears_at_its_computed_picture_position(plane: Plane, axes: np.ndarray) -> None:
    right, down = (np.array(one) for one in DIRECTIONS[plane])
    normal = np.cross(right, down)
    cut = picture(plane, normal * float(MARK_MM @ normal))
    hu = sample_cut_hu(volume(axes), cut)
    row, column = np.unravel_index(hu.argmax(), hu.shape)
    x, y, off_mm = cut.to_picture(MARK_MM)
    assert (column + 0.5, row + 0.5) == pytest.approx((x, y), abs=2.0)
    assert off_mm == pytest.approx(0.0)
    assert np.allclose(cut.to_patient_mm(x, y), MARK_MM)


def test_the_sides_of_the_pictures_follow_the_radiological_convention() -> None:
    said = {plane: [side_letters(np.array(one)) for one in DIRECTIONS[plane]] for plane in DIRECTIONS}
    assert said == {Plane.AXIAL: ["L", "P"], Plane.CORONAL: ["L", "I"], Plane.SAGITTAL: ["P", "I"]}
    assert side_letters(np.array([0.8, -0.6, 0.0])) == "LA"


@pytest.mark.parametrize(
    ("right", "down"),
    [
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((0.8, 0.6, 0.0), (0.0, 0.0, -1.0)),
        ((0.6, 0.0, 0.8), (0.0, 1.0, 0.0)),
    ],
)
def test_every_pixel_agrees_with_scipy_interpolation(
    right: tuple[float, ...], down: tuple[float, ...]
) -> None:
    scan = volume()
    cut = Cut(np.array([1.0, 2.0, 3.0]), np.array(right), np.array(down), 0.1)
    hu = sample_cut_hu(scan, cut)
    random = np.random.default_rng(1)
    rows, columns = random.integers(SIZE_PX, size=(2, 200))
    places = [cut.to_patient_mm(x + 0.5, y + 0.5) for x, y in zip(columns, rows, strict=True)]
    index = scan.geometry.to_index(places)
    if abs(right[2]) < 1e-9 and abs(down[2]) < 1e-9:
        index[:, 0] = np.rint(index[:, 0])  # of one slice
    sampled = map_coordinates(scan.voxels.astype(float), index.T, order=1)
    assert np.abs(hu[rows, columns] - sampled).max() < 12.0  # OpenCV interpolates in steps of 1/32 of a pixel


def test_unscanned_regions_are_grey_and_not_black_like_air() -> None:
    cut = picture(Plane.AXIAL, np.array([0.0, 0.0, 500.0]))
    assert (sample_cut_hu(volume(), cut) == UNSCANNED_HU).all()
    shown = shown_grey(cut, (-100.0, 100.0))
    assert shown.shape == (SIZE_PX, SIZE_PX)
    assert (shown == UNSCANNED_GREY).all()


def test_the_window_is_black_at_its_lower_and_white_at_its_upper_limit() -> None:
    cut = picture(Plane.AXIAL, MARK_MM * (0.0, 0.0, 1.0))
    shown = shown_grey(cut, (0.0, 500.0))
    hu = sample_cut_hu(volume(), cut)
    assert (shown[hu >= 500] == 255).all()
    middle = shown[(hu > 240) & (hu < 260)]
    assert len(middle)
    assert abs(middle.astype(float) - 127.5).max() < 8
