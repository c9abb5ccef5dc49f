"""The page of a CT is self-contained, and its voxels are at the same place as those of the series."""

from __future__ import annotations

import base64
import json
import re
from typing import Any

import cv2
import numpy as np
import pytest
from localized_spheres import as_volume
from painted_ct import Scan

from procedures.imaging import Candidate, Volume, VoxelGeometry, localize
from procedures.imaging.ct_page import BRIGHTEST_HU, DARKEST_HU, LEVELS, ct_page, view_volume

SHAPE = (40, 300, 600)  # more rows and columns than a page shows


def ramp_volume() -> Volume:
    """HU that grow along every axis, in a turned patient."""
    voxels = np.add.outer(np.add.outer(np.arange(40) * 20, np.arange(300)), np.arange(600)) - 1000
    axes = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    geometry = VoxelGeometry(SHAPE, np.array([5.0, -7.0, 11.0]), axes, np.array([1.5, 0.5, 0.5]))
    return Volume(voxels.astype(np.int16), geometry, "1.2.3", "1.2.4")


def test_a_voxel_of_the_page_is_at_the_position_of_the_voxels_it_represents() -> None:
    volume = ramp_volume()
    view = view_volume(volume)
    assert max(view.grey.shape) <= 256
    for index in ((0, 0, 0), (39, 149, 199), (17, 80, 33)):
        here = volume.geometry.to_index(view.geometry.to_patient_mm(index))
        hu = float(here @ (20, 1, 1)) - 1000.0  # the ramp, at fractions of an index
        shown_hu = DARKEST_HU + view.grey[index] / LEVELS * (BRIGHTEST_HU - DARKEST_HU)
        assert shown_hu == pytest.approx(hu, abs=0.51 * (BRIGHTEST_HU - DARKEST_HU) / LEVELS)


def content_of(page: str) -> dict[str, Any]:
    (found,) = re.findall(r'<script type="application/json" id="content">(.*?)</script>', page, re.DOTALL)
    return dict(json.loads(found))


def test_the_page_contains_every_slice_and_the_markers_found() -> None:
    scan = Scan(shape=(40, 80, 140))
    scan.ball(np.array([20.0, 20.0, 20.0]))
    volume = as_volume(scan)
    found = localize(volume)
    content = content_of(ct_page(volume, "series", found.markers, found.candidates, "1 marker found."))
    assert [one["centre_mm"] for one in content["found"]] == found.centres_mm.tolist()
    assert [one["odds"] for one in content["found"]] == [one.odds for one in found.markers]
    mosaic = cv2.imdecode(np.frombuffer(base64.b64decode(content["mosaic"]), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert mosaic is not None
    slices, rows, columns = content["shape"]
    grey = view_volume(volume).grey
    for number in (0, 13, slices - 1):
        down, across = divmod(number, content["across"])
        tile = mosaic[down * rows : (down + 1) * rows, across * columns : (across + 1) * columns]
        assert np.abs(tile.astype(int) - grey[number]).mean() < 2.0


def test_doubtful_and_rejected_candidates_are_apart_with_reasons_and_odds() -> None:
    one = Candidate((1.0, 2.0, 3.0), False, "is doubtful: ends under its cover", 900.0, 0.9, 5.7, 0.45)
    other = Candidate((4.0, 5.0, 6.0), False, "shows no surface", 300.0)
    content = content_of(ct_page(ramp_volume(), "series", (), (one, other), "no marker found."))
    for kind, there in (("doubtful", one), ("rejected", other)):
        (shown,) = content[kind]
        assert (shown["remarks"], shown["odds"]) == (there.reason, there.odds)
    assert content["found"] == []


def test_the_page_fetches_nothing_and_escapes_names() -> None:
    page = ct_page(ramp_volume(), "<b>x</b>", (), (), "</script><script>alert(1)")
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:)|url\(|https?:|@import", page)
    assert "<b>x" not in page
    assert "alert(1)" in page
    assert "<script>alert" not in page
