"""The thesis' localization protocol and its printed tables."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from procedures.registration.error_theory import fle_from_fre_mm, fle_of_one_space_mm
from studies.localization.study import AUTOMATIC, OURS
from studies.localization.thesis_protocol import (
    FRAME_MM,
    LARGEST_SCALE_ERROR,
    PHANTOM,
    SCALE_DRAWS,
    THESIS_SCANS,
    LocalizedScan,
    ThesisLocalizationStudy,
    draw_scale,
    fle_mm,
    points_as_sums,
    points_of,
    tables,
)
from studies.thesis_tables import (
    AVERAGE_OPERATOR,
    FIDUCIALS_OF_TABLE_3,
    HUMAN_OPERATORS,
    LINE_FIT,
    OPERATORS,
    SPHERE_FIT,
    TABLE_2,
    TABLE_3,
    TABLE_4,
)


def test_the_scans_are_those_of_the_thesis() -> None:
    assert Counter(scan.kind for scan in THESIS_SCANS) == {"phantom": 8, "patient": 12}
    assert sum(scan.spheres for scan in THESIS_SCANS) == 116
    assert [unit.condition for unit in ThesisLocalizationStudy().units()] == [
        one.condition for one in THESIS_SCANS
    ]


def test_a_scale_error_is_common_within_a_slice_and_independent_along_the_table() -> None:
    scales = draw_scale(np.random.default_rng(1), 1000)
    assert np.array_equal(scales[:, 0], scales[:, 1])
    assert abs(np.corrcoef(scales[:, 0], scales[:, 2])[0, 1]) < 0.1
    assert np.abs(scales - 1.0).max() <= LARGEST_SCALE_ERROR


def test_a_known_error_is_recovered_against_the_truth_and_between_scans() -> None:
    random = np.random.default_rng(2)
    scans = [FRAME_MM + random.normal(size=FRAME_MM.shape) * 0.1 for _ in range(60)]
    truth, fre, between = fle_mm(scans, np.ones((1, 60, 3)))
    assert between == pytest.approx(0.1 * np.sqrt(3.0), rel=0.05)
    assert truth == pytest.approx(between, rel=0.1)  # a mean over scans, not their rms
    assert truth == pytest.approx(fre * np.sqrt(2.0))


def test_the_frame_is_identified_in_its_order_and_an_incomplete_one_is_refused() -> None:
    order = [2, 0, 3, 1]
    found = LocalizedScan(np.vstack([FRAME_MM[order], [[10.0, 20.0, 120.0]]]), 1.0)
    seen = found.frame_mm(np.ones(3))
    assert seen is not None
    assert np.array_equal(seen, FRAME_MM)
    assert LocalizedScan(FRAME_MM[:3], 1.0).frame_mm(np.ones(3)) is None


def test_coordinates_are_recovered_from_the_sums() -> None:
    assert np.array_equal(points_of(points_as_sums("who", FRAME_MM), "who"), FRAME_MM)
    assert points_of({}, "who") is None


def test_the_reproduction_is_compared_with_both_tables_including_gain_and_time() -> None:
    random = np.random.default_rng(3)
    sums = {}
    for scan in THESIS_SCANS:
        one = {"spheres": float(scan.spheres)}
        for method in AUTOMATIC:
            sigma_mm = {OURS: 0.005, "thesis-line": 0.05}.get(method, 0.03)
            one |= points_as_sums(method, FRAME_MM + random.normal(size=(4, 3)) * sigma_mm)
            counts = {"found": scan.spheres, "false": 0, "validated": SCALE_DRAWS, "cpu_s": 1.5}
            one |= {f"{method}|{key}": float(value) for key, value in counts.items()}
        sums[scan.condition] = one
    detection, errors, gains, times = tables(sums)
    assert [row[1:] for row in detection.rows[:2]] == [
        (PHANTOM, 8, 64, 64, "at least 95.43", 0, "at most 3", 100.0),
        ("patient", 12, 52, 52, "at least 94.4", 0, "at most 3", 100.0),
    ]
    scaled = {row[0]: row for row in errors.rows if row[1] == 100.0 * LARGEST_SCALE_ERROR}
    assert (scaled["thesis-line"][4], scaled["thesis-line"][6]) == (
        0.1685,
        0.2604,
    )
    assert scaled[OURS][2] < scaled["thesis-line"][2]
    printed = {(row[0], row[1]): round(row[5], 2) for row in gains.rows if row[5] is not None}
    assert printed[("thesis-sphere", "2")] == 49.29
    assert printed[("thesis-sphere", "3")] == 45.91
    assert [row[1] for row in times.rows[:3]] == [191.5, 28.8, 1.5]


TRUNCATED = "operator 3"  # 0.36908 is printed 0.3690


@pytest.mark.parametrize("column", TABLE_2)
def test_table_2_prints_the_mean_of_its_rows(column: str) -> None:
    assert round(float(np.mean(TABLE_2[column].rows_mm)), 4) == TABLE_2[column].printed_mm


@pytest.mark.parametrize("column", sorted(TABLE_3.keys() - {AVERAGE_OPERATOR, TRUNCATED}))
def test_table_3_prints_the_fle_computed_from_its_fre(column: str) -> None:
    fle_mm = fle_of_one_space_mm(TABLE_3[column].rows_mm, FIDUCIALS_OF_TABLE_3)
    assert round(fle_mm, 4) == TABLE_3[column].printed_mm


def test_the_fle_of_operator_3_is_truncated_instead_of_rounded() -> None:
    fle_mm = fle_of_one_space_mm(TABLE_3[TRUNCATED].rows_mm, FIDUCIALS_OF_TABLE_3)
    assert (round(fle_mm, 4), np.floor(fle_mm * 1e4) / 1e4) == (0.3691, TABLE_3[TRUNCATED].printed_mm)


def test_the_average_operator_is_the_mean_of_the_four_fle_and_not_the_fle_of_its_rows() -> None:
    rows_mm = TABLE_3[AVERAGE_OPERATOR].rows_mm
    four_mm = [fle_of_one_space_mm(TABLE_3[name].rows_mm, FIDUCIALS_OF_TABLE_3) for name in OPERATORS]
    assert round(float(np.mean(four_mm)), 4) == TABLE_3[AVERAGE_OPERATOR].printed_mm
    assert round(fle_of_one_space_mm(rows_mm, FIDUCIALS_OF_TABLE_3), 4) == 0.4601
    means_mm = np.mean([TABLE_3[name].rows_mm for name in OPERATORS], axis=0)
    assert np.sort(rows_mm) == pytest.approx(np.sort(means_mm), abs=1.5e-4)


@pytest.mark.parametrize("row", TABLE_4)
def test_table_4_prints_the_mean_over_its_trajectories(row: tuple[str, int]) -> None:
    mean_mm = float(np.mean(TABLE_4[row].trajectories_mm))
    assert mean_mm == pytest.approx(TABLE_4[row].mean_mm, abs=0.6e-3)  # the rows are rounded themselves


@pytest.mark.parametrize("column", [LINE_FIT, SPHERE_FIT, HUMAN_OPERATORS])
def test_table_3_is_the_fle_computed_from_table_2_taken_as_the_fre(column: str) -> None:
    fre_mm = float(np.sqrt(np.mean(np.square(TABLE_2[column].rows_mm))))
    of_table_3 = TABLE_3[AVERAGE_OPERATOR if column == HUMAN_OPERATORS else column].rows_mm
    fle_mm = fle_of_one_space_mm(of_table_3, FIDUCIALS_OF_TABLE_3)
    assert fle_mm == pytest.approx(fle_from_fre_mm(fre_mm, FIDUCIALS_OF_TABLE_3), rel=0.015)
