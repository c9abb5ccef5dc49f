"""Every instrument and every hole belongs to one trajectory, whatever else lies within reach."""

from __future__ import annotations

import numpy as np

from procedures.postoperative.comparison import Candidate, FoundKind, assign
from procedures.postoperative.planned_line import ExpectedFit, FitQuality, PlannedLine

DOWN = np.array([0.0, 0.0, -1.0])
WAYS = {
    name: PlannedLine(np.array([x_mm, 0.0, 0.0]), np.array([x_mm, 0.0, -60.0]))
    for name, x_mm in (("T1", 0.0), ("T2", 6.0))
}


def rod(x_mm: float, tip_mm: float = -60.0) -> Candidate:
    return Candidate(FoundKind.INSTRUMENT, np.array([x_mm, 0.0, tip_mm]), DOWN)


def hole(x_mm: float) -> Candidate:
    return Candidate(FoundKind.DRILL_HOLE, np.array([x_mm, 0.0, -8.0]), DOWN)


def test_two_nearby_trajectories_each_get_their_own_instrument() -> None:
    found, lost_to = assign(WAYS, {name: (rod(6.4), rod(0.5)) for name in WAYS})
    assert {name: one.point_mm[0] for name, one in found.items()} == {"T1": 0.5, "T2": 6.4}
    assert lost_to == {}


def test_a_contested_instrument_goes_to_the_nearer_trajectory_and_the_other_names_it() -> None:
    found, lost_to = assign(WAYS, {name: (rod(4.0),) for name in WAYS})
    assert set(found) == {"T2"}
    assert lost_to == {"T1": "T2"}


def test_a_rod_with_different_ends_in_two_windows_counts_as_one() -> None:
    _, lost_to = assign(WAYS, {"T1": (rod(4.0, tip_mm=-40.0),), "T2": (rod(4.0),)})
    assert lost_to == {"T1": "T2"}


def test_an_instruments_hole_is_not_assigned_to_another_trajectory() -> None:
    found, lost_to = assign(WAYS, {"T1": (rod(0.5), hole(0.4)), "T2": (hole(0.4),)})
    assert found["T1"].kind is FoundKind.INSTRUMENT
    assert lost_to == {"T2": "T1"}


def test_a_hole_is_assigned_when_the_instrument_belongs_to_another_trajectory() -> None:
    found, _ = assign(WAYS, {"T1": (rod(6.2), hole(0.1)), "T2": (rod(6.2),)})
    assert (found["T1"].kind, found["T2"].kind) == (FoundKind.DRILL_HOLE, FoundKind.INSTRUMENT)


def test_a_trajectory_without_candidates_is_neither_found_nor_lost() -> None:
    assert assign(WAYS, {"T1": (), "T2": ()}) == ({}, {})


def test_a_sound_fit_is_preferred_to_a_failed_one() -> None:
    failed = Candidate(FoundKind.INSTRUMENT, np.array([0.0, 0.0, -60.0]), DOWN, failures=("it did not end",))
    found, _ = assign(WAYS, {"T1": (failed, rod(3.0)), "T2": ()})
    assert found["T1"].failures == ()


def test_a_fit_is_judged_by_its_end_its_limits_its_residual_and_its_radius() -> None:
    usual = ExpectedFit(residual_hu=100.0, radius_mm=(0.5, 4.0))
    good = FitQuality(whole=True, ended=True, inside=True, residual_hu=60.0, radius_mm=1.5)
    assert usual.failures(good) == usual.doubts(good) == ()
    bad = FitQuality(whole=False, ended=False, inside=False, residual_hu=130.0, radius_mm=4.5)
    assert len(usual.failures(bad)) == 3
    left, radius = usual.doubts(bad)
    assert "130 HU" in left
    assert "4.50 mm" in radius
