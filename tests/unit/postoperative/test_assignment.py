"""Every instrument and every hole is one trajectory's, whatever else lies within its reach."""

from __future__ import annotations

import numpy as np

from procedures.postoperative.assignment import Candidate, FoundKind, assigned
from procedures.postoperative.fit_quality import FitQuality, Usual
from procedures.postoperative.way import Way

DOWN = np.array([0.0, 0.0, -1.0])
WAYS = {
    name: Way(np.array([x_mm, 0.0, 0.0]), np.array([x_mm, 0.0, -60.0]))
    for name, x_mm in (("T1", 0.0), ("T2", 6.0))
}


def rod(x_mm: float, tip_mm: float = -60.0) -> Candidate:
    return Candidate(FoundKind.INSTRUMENT, np.array([x_mm, 0.0, tip_mm]), DOWN)


def hole(x_mm: float) -> Candidate:
    return Candidate(FoundKind.DRILL_HOLE, np.array([x_mm, 0.0, -8.0]), DOWN)


def test_of_two_near_each_other_each_has_its_own() -> None:
    found, lost_to = assigned(WAYS, {name: (rod(6.4), rod(0.5)) for name in WAYS})
    assert {name: one.point_mm[0] for name, one in found.items()} == {"T1": 0.5, "T2": 6.4}
    assert lost_to == {}


def test_one_that_both_could_have_is_the_nearer_ones_and_the_other_is_told_so() -> None:
    found, lost_to = assigned(WAYS, {name: (rod(4.0),) for name in WAYS})
    assert set(found) == {"T2"}
    assert lost_to == {"T1": "T2"}


def test_one_rod_that_ends_otherwise_in_another_window_is_still_one() -> None:
    _, lost_to = assigned(WAYS, {"T1": (rod(4.0, tip_mm=-40.0),), "T2": (rod(4.0),)})
    assert lost_to == {"T1": "T2"}


def test_the_hole_of_an_instrument_is_not_another_trajectorys_hole() -> None:
    found, lost_to = assigned(WAYS, {"T1": (rod(0.5), hole(0.4)), "T2": (hole(0.4),)})
    assert found["T1"].kind is FoundKind.INSTRUMENT
    assert lost_to == {"T2": "T1"}


def test_a_hole_is_taken_where_the_instrument_is_another_trajectorys() -> None:
    found, _ = assigned(WAYS, {"T1": (rod(6.2), hole(0.1)), "T2": (rod(6.2),)})
    assert (found["T1"].kind, found["T2"].kind) == (FoundKind.DRILL_HOLE, FoundKind.INSTRUMENT)


def test_nothing_found_is_neither_found_nor_lost() -> None:
    assert assigned(WAYS, {"T1": (), "T2": ()}) == ({}, {})


def test_a_failed_fit_counts_only_where_nothing_else_is() -> None:
    failed = Candidate(FoundKind.INSTRUMENT, np.array([0.0, 0.0, -60.0]), DOWN, failures=("it did not end",))
    found, _ = assigned(WAYS, {"T1": (failed, rod(3.0)), "T2": ()})
    assert found["T1"].failures == ()


def test_a_fit_is_judged_by_its_end_its_limits_what_is_left_and_its_radius() -> None:
    usual = Usual(residual_hu=100.0, radius_mm=(0.5, 4.0))
    good = FitQuality(ended=True, inside=True, residual_hu=60.0, radius_mm=1.5)
    assert usual.failures(good) == usual.doubts(good) == ()
    bad = FitQuality(ended=False, inside=False, residual_hu=130.0, radius_mm=4.5)
    assert len(usual.failures(bad)) == 2
    left, radius = usual.doubts(bad)
    assert "130 HU" in left
    assert "4.50 mm" in radius
