"""A scan written as PLY or VTP holds every point with its covariance, look and line."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from procedures.exchange.surface_files import encode_scan_ply, encode_scan_vtp
from procedures.registration.surface.scan import SurfaceScan
from ronna_hw.frames import Frame


@pytest.fixture
def scan() -> SurfaceScan:
    random = np.random.default_rng(4)
    half = random.normal(size=(5, 3, 3))
    return SurfaceScan(
        points_mm=random.uniform(-900.0, 900.0, (5, 3)),
        covariance_mm2=1e-4 * half @ half.transpose(0, 2, 1) + 1e-6 * np.eye(3),
        look=np.array([0, 0, 1, 1, 1]),
        line=np.arange(5),
        view_mm=random.uniform(-900.0, 900.0, (5, 3)),
    )


def test_ply_names_its_columns_and_keeps_every_digit(scan: SurfaceScan) -> None:
    head, _, body = encode_scan_ply(scan, Frame.CT).partition(b"end_header\n")

    lines = head.decode().splitlines()
    properties = [each.split()[1:] for each in lines if each.startswith("property")]
    kinds = {"double": "<f8", "int": "<i4"}
    rows = np.frombuffer(body, dtype=[(name, kinds[kind]) for kind, name in properties])
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert "in the frame ct (LPS)" in lines[2]
    np.testing.assert_array_equal(np.column_stack([rows[each] for each in "xyz"]), scan.points_mm)
    np.testing.assert_array_equal(rows["covariance_yz"], scan.covariance_mm2[:, 1, 2])
    assert rows["look"].tolist() == [0, 0, 1, 1, 1]


def test_vtp_has_one_vertex_for_each_point(scan: SurfaceScan) -> None:
    root = ElementTree.fromstring(encode_scan_vtp(scan))

    arrays = {each.get("Name"): each for each in root.iter("DataArray")}
    piece = root.find("PolyData/Piece")
    assert piece is not None
    assert piece.get("NumberOfVerts") == "5"
    points = np.array((arrays["points_mm"].text or "").split(), float).reshape(-1, 3)
    np.testing.assert_allclose(points, scan.points_mm, atol=1e-6)
    assert arrays["covariance_mm2"].get("NumberOfComponents") == "6"
    assert (arrays["line"].text or "").split() == ["0", "1", "2", "3", "4"]
