"""Two scans of one head say where its skin moved, and whether the head did."""

from __future__ import annotations

import numpy as np
from coded_errors import raises

from procedures.registration.surface.compare_scans import compare_scans
from procedures.registration.surface.errors import SCANS_APART

TARGET_MM = np.array([0.0, 20.0, 0.0])


def again(made, shift_mm):
    """Scan again with other noise, displaced by what is given for each place in the CT."""
    places = made.truth.inverse().apply(made.scan.points_mm)
    turn = made.truth.rotation_matrix
    noise = np.random.default_rng(5).normal(size=places.shape) * 0.05
    scan = made.scan
    moved = scan.points_mm + shift_mm(places) @ turn.T + noise
    return type(scan)(moved, scan.covariance_mm2, scan.look, scan.line, scan.view_mm)


def test_skin_that_stayed_is_said_to_have_stayed(heads, scan_of):
    made = scan_of(heads[0], 21, count=300)
    found = compare_scans(made.scan, again(made, np.zeros_like), heads[0], made.truth)
    assert not found.changed
    assert found.common > 0.9
    moved, error = found.movement_at(TARGET_MM)
    assert np.linalg.norm(moved) < error.limit_mm(0.999)


def test_a_cheek_that_swelled_is_found_with_its_size(heads, scan_of):
    def swell(places):
        near = np.linalg.norm(places - [40.0, -65.0, -58.0], axis=1) < 28.0
        return 1.2 * near[:, None] * heads[0].find_normals(places)

    made = scan_of(heads[0], 22, count=300)
    found = compare_scans(made.scan, again(made, swell), heads[0], made.truth)
    assert found.changed
    assert 0.6 < found.changed.shift_mm < 1.6
    moved, _ = found.movement_at(TARGET_MM)
    assert np.linalg.norm(moved) < 0.3


def test_a_head_that_moved_is_no_skin_that_moved(heads, scan_of):
    made = scan_of(heads[0], 23, count=300)
    shift = np.array([0.8, -0.5, 0.3])
    found = compare_scans(
        made.scan, again(made, lambda places: np.tile(shift, (len(places), 1))), heads[0], made.truth
    )
    assert not found.changed
    moved, error = found.movement_at(TARGET_MM)
    in_ct = made.truth.rotation_matrix.T @ moved
    assert np.linalg.norm(in_ct - shift) < max(error.limit_mm(), 0.15)


def test_scans_of_other_parts_cannot_be_compared(heads, scan_of):
    made = scan_of(heads[0], 24, count=300)
    left = made.truth.inverse().apply(made.scan.points_mm)[:, 0]
    with raises(SCANS_APART):
        compare_scans(made.scan.select(left > 15.0), made.scan.select(left < -15.0), heads[0], made.truth)
