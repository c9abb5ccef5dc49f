"""Pictures of markers show their planes in the right orientation."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from localized_spheres import as_volume
from painted_ct import Scan
from PIL import ImageColor

from procedures.imaging import Volume, VoxelGeometry, localize
from procedures.imaging.pictures import (
    _PLANES,
    HALF_WIDTH_MM,
    RING_COLOUR,
    UNSCANNED_COLOUR,
    _plane_name,
    _sample_planes,
    _Sheet,
    draw_markers,
)


def volume_with_balls() -> Volume:
    scan = Scan(shape=(40, 80, 140))
    for column_mm in (20.0, 50.0):
        scan.ball(np.array([20.0, 20.0, column_mm]))
    return as_volume(scan)


def test_every_marker_has_a_png_of_three_planes() -> None:
    volume = volume_with_balls()
    result = localize(volume, expected=2)
    pictures = draw_markers(volume, result)
    assert len(pictures) == 2
    for picture in pictures:
        pixels = cv2.imdecode(np.frombuffer(picture, dtype=np.uint8), cv2.IMREAD_COLOR)
        assert pixels is not None
        assert pixels.shape == (480, 960, 3)
        assert pixels.std() > 30  # black air, bright balls


def test_each_plane_is_centred_on_the_sphere() -> None:
    planes = _sample_planes(volume_with_balls(), np.array([20.0, 20.0, 20.0]))
    for plane in planes:
        bright = np.argwhere(plane > -400)
        step_mm = 2 * HALF_WIDTH_MM / (len(plane) - 1)
        np.testing.assert_allclose(bright.mean(axis=0), (len(plane) - 1) / 2, atol=1.0)
        np.testing.assert_allclose(len(bright) * step_mm**2, np.pi * 5.75**2, rtol=0.03)


def test_unscanned_regions_are_not_shown_as_air() -> None:
    volume = volume_with_balls()
    _, _, along_columns = _sample_planes(volume, np.array([20.0, 2.0, 20.0]))
    across = np.linspace(-HALF_WIDTH_MM, HALF_WIDTH_MM, len(along_columns))
    assert np.isnan(along_columns[:, across < -2.1]).all()
    assert np.isfinite(along_columns[:, across > -1.9]).all()


def test_a_ring_shows_the_sphere_and_blue_what_was_not_scanned() -> None:
    near_the_edge = np.array([20.0, 2.0, 20.0])
    sheet = _Sheet(volume_with_balls())

    def colours(picture: bytes) -> set[tuple[int, ...]]:
        pixels = cv2.imdecode(np.frombuffer(picture, dtype=np.uint8), cv2.IMREAD_COLOR_RGB)
        assert pixels is not None
        return set(map(tuple, pixels.reshape(-1, 3).tolist()))

    ring, unscanned = ImageColor.getrgb(RING_COLOUR), ImageColor.getrgb(UNSCANNED_COLOUR)
    assert {ring, unscanned} <= colours(sheet.draw(near_the_edge, 5.75, "marker"))
    assert ring not in colours(sheet.draw(near_the_edge, None, "candidate"))


def turned(degrees: float) -> np.ndarray:
    """Columns slice, row, column of an axial scan whose slices are tilted about the left-right axis."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[0.0, 0.0, 1.0], [-sine, cosine, 0.0], [cosine, sine, 0.0]])


@pytest.mark.parametrize(
    ("degrees", "names"),
    [
        (0.0, ["axial", "coronal", "sagittal"]),
        (20.0, ["oblique, nearly axial", "oblique, nearly coronal", "sagittal"]),
        (90.0, ["coronal", "axial", "sagittal"]),
    ],
)
def test_planes_have_their_clinical_names(degrees: float, names: list[str]) -> None:
    geometry = VoxelGeometry((4, 4, 4), np.zeros(3), turned(degrees), np.ones(3))
    assert [_plane_name(geometry, through) for _, _, through in _PLANES] == names
