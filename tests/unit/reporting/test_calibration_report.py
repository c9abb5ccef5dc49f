"""The report of a calibration, a check or a single measurement shows every figure with its spread."""

from __future__ import annotations

import csv
import json
from typing import Any

import pytest
from clinical_case import ClinicalCell
from prepared_results import imported_ct
from report_text import report_text

from procedures.reporting.calibration_figures import KINDS, RESULT_FILE, HeadFigures
from procedures.reporting.outcome import RunError
from procedures.reporting.report import write_report

COVARIANCE = [[0.0004, 0.0, 0.0], [0.0, 0.0009, 0.0], [0.0, 0.0, 0.0016]]
HEAD: dict[str, Any] = {
    "calibration": "stereo-head-7",
    "created": "2026-01-01T10:00:00+00:00",
    "expires": "2026-01-31T10:00:00+00:00",
    "serials": ["1", "2"],
    "poses": 2,
    "outliers": [1],
    "image_sigma_px": 0.007,
    "arm_error_mm": 0.305,
    "arm_scatter_mm": 0.015,
    "stated_error_mm": 0.04,
    "tool_error_mm": 0.03,
    "tool_covariance_mm2": COVARIANCE,
    "tool_shift_mm": 0.123,
    "frame_misfit_mm": 0.007,
    "head_moved": False,
    "ball_mm": [500.0, 0.0, 300.0],
    "flange_from_tool": {"translation_mm": [217.574, 1.788, 62.461], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]},
    "residuals_px": [[0.1, 0.1, 0.1, 0.1], [3.0, 3.0, 3.0, 3.0]],
    "shifts_mm": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
}
CHECK: dict[str, Any] = {
    "calibration": "stereo-head-7",
    "baseline_created": "2026-01-01T10:00:00+00:00",
    "passed": False,
    "looks": 24,
    "repeatability_mm": 0.011,
    "ball_moved_mm": [0.0, 0.0, 0.1],
    "signs": [
        {"name": "gap", "unit": "mm", "value": [0.0321], "sigma": [0.0011]}
        | {"statistic": 851.0, "limit": 10.8, "sounds": True}
    ],
}
OUTLINE: dict[str, Any] = {
    "centre_px": [1024.0, 544.0],
    "axes_px": [260.0, 259.0],
    "quality": 0.9,
    "status": "OK",
    "rim_fraction": 1.0,
    "scatter_px": 0.05,
    "blur_px": 1.2,
}
LOOK: dict[str, Any] = {
    "position_mm": [-0.3526, 0.9668, -0.1895],
    "covariance_mm2": COVARIANCE,
    "ray_gap_mm": 0.0036,
    "radius_mm": 5.749,
    "left": OUTLINE,
    "right": OUTLINE,
}


def page(cell: ClinicalCell, content: str, error: RunError | None = None) -> str:
    cell.begin(imported_ct()).close("done")
    (cell.folder / RESULT_FILE).write_text(content)
    return report_text(write_report(cell.folder, error=error))


@pytest.mark.parametrize(
    ("figures", "value", "spread"),
    [(HEAD, "217.574", "0.020"), (CHECK, "0.03210", "0.00110"), (LOOK, "-0.3526", "0.0200")],
    ids=["calibration", "check", "look"],
)
def test_every_figure_is_shown_next_to_its_spread(
    cell: ClinicalCell, figures: dict[str, Any], value: str, spread: str
) -> None:
    assert f'<td class="free">{value}</td><td>{spread}</td>' in page(cell, json.dumps(figures))


def test_the_key_that_identifies_a_kind_of_figures_is_always_in_it_and_never_in_another() -> None:
    owners = {key: [kind for kind in KINDS.values() if key in kind.model_fields] for key in KINDS}
    assert owners == {key: [kind] for key, kind in KINDS.items()}
    assert all(kind.model_fields[key].is_required() for key, kind in KINDS.items())


@pytest.mark.hazard(26)
@pytest.mark.parametrize(("smallest_mm", "shown"), [(3.84, True), (0.04, False), (None, False)])
def test_a_calibration_says_how_large_a_slip_of_the_head_it_can_see_and_what_sees_a_smaller_one(
    smallest_mm: float | None, shown: bool
) -> None:
    figures = HeadFigures.model_validate_json(json.dumps({**HEAD, "smallest_slip_mm": smallest_mm}))
    said = " ".join(figures.warnings())
    assert ("less than 3.84 mm" in said) is shown
    assert ("ronna-stereo check" in said) is shown


def test_excluded_acquisitions_are_drawn_and_listed_as_such(cell: ClinicalCell) -> None:
    page(cell, json.dumps(HEAD))
    rows = list(csv.DictReader((cell.folder / "report" / "looks.csv").read_text().splitlines()))
    assert [(row["rms_px"], row["used"]) for row in rows] == [("0.1", "True"), ("3.0", "False")]
    assert (cell.folder / "report" / "looks.svg").exists()


def test_a_check_that_found_a_change_is_reported_as_failed(cell: ClinicalCell) -> None:
    text = page(cell, json.dumps(CHECK), RunError(code="CAL-006", what="the stereo head has changed"))
    assert "changed: chi-square 851.0, limit 10.8" in text
    assert "<strong>Failed.</strong> Every step was done, but the stereo head has changed (CAL-006)" in text


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"position_mm": [NaN, 0, 0]}'])
def test_unreadable_figures_do_not_keep_the_rest_of_the_report_from_being_shown(
    cell: ClinicalCell, content: str
) -> None:
    text = page(cell, content)
    assert "<h2>Result</h2>" not in text
    assert "Where the results come from" in text
