"""The surface of the head, extracted from the CT in patient coordinates."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from console.scene.head_surface import head_surface, series_of, stl
from procedures.imaging.volume import Volume, VoxelGeometry

SHAPE = (60, 80, 70)  # slices, rows, columns
SPACING_MM = np.array([2.0, 1.0, 1.5])
ORIGIN_MM = np.array([-50.0, -30.0, 700.0])
AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # slices go up, columns left


def scan(mark: bool = True) -> Volume:
    """A ball with an air-filled hollow, a mark on its left side, and a headrest that is no head."""
    geometry = VoxelGeometry(SHAPE, ORIGIN_MM, AXES, SPACING_MM)
    places = np.moveaxis(np.indices(SHAPE), 0, -1)
    lps = geometry.to_patient_mm(places)
    middle = geometry.to_patient_mm(np.array(SHAPE) / 2)
    radius = np.linalg.norm(lps - middle, axis=-1)
    solid = (radius < 25.0) & (radius > 8.0)
    if mark:
        solid |= (np.abs(lps - middle - [28.0, 0.0, 0.0]) < 7.0).all(axis=-1)
    solid |= lps[..., 1] > middle[1] + 36.0
    return Volume(np.where(solid, 40, -1000).astype(np.int16), geometry, "1.2", "1.3")


def test_the_surface_is_the_filled_head_without_the_headrest_and_not_mirrored() -> None:
    volume = scan()
    corners, triangles = head_surface(volume)
    middle = volume.geometry.to_patient_mm(np.array(SHAPE) / 2)
    from_middle = corners - middle
    distances = np.linalg.norm(from_middle, axis=1)
    assert distances.min() > 20.0  # the hollow is filled
    assert from_middle[:, 1].max() < 30.0  # without the headrest, which is posterior
    assert from_middle[:, 0].max() > 31.0  # the mark is left
    assert from_middle[:, 0].min() > -28.0
    assert np.median(distances) == pytest.approx(25.0, abs=1.5)
    assert triangles.max() < len(corners)


def test_an_empty_scan_has_no_head() -> None:
    geometry = VoxelGeometry(SHAPE, ORIGIN_MM, AXES, SPACING_MM)
    with pytest.raises(ValueError, match="only air"):
        head_surface(Volume(np.full(SHAPE, -1000, np.int16), geometry, "1.2", "1.3"))


def test_the_mesh_is_written_as_binary_stl_in_metres() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1000.0, 0.0, 0.0], [0.0, 1000.0, 0.0]])
    content = stl(corners, np.array([[0, 1, 2]]))
    assert len(content) == 84 + 50
    assert struct.unpack("<I12f", content[80:132]) == (1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0)


def test_the_series_in_the_run_folder_takes_precedence_over_the_one_in_the_request(tmp_path: Path) -> None:
    assert series_of(tmp_path) is None
    (tmp_path / "request.json").write_text('{"case": "/data/case-7"}')
    assert series_of(tmp_path) == Path("/data/case-7/ct")
    (tmp_path / "case" / "ct").mkdir(parents=True)
    assert series_of(tmp_path) == tmp_path / "case" / "ct"
