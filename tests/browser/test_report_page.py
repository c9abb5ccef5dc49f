"""The report on a phone and on paper, as a browser lays it out: nothing is cut off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from clinical_case import FIRST, ClinicalCell
from prepared_results import checked_paths, mounted_guide, relocalization, up_to_correspondence
from report_layout import PHONE_PX, count_pages, hidden_by_width, misfits

from procedures.journal.journal import Entry
from procedures.reporting.case_sheet.sheet import sheet_of_run
from procedures.reporting.comparison.page import compare_runs
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.reporting.report import write_report
from procedures.steps.clinical import registration
from procedures.steps.clinical.path_check import ClosestApproach, MotionPreview
from procedures.workcell import MountedTool

A4_PX = 688  # 210 mm without the page's margins of 14 mm, at 96 pixels per inch
STYLES = "(elements, rule) => elements.map(one => getComputedStyle(one)[rule])"
TRUTH = Truth(targets=(TargetTruth(id=FIRST, application_error_mm=0.4321, lateral_mm=0.4, axial_mm=-0.1),))


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a case that goes as far as the registration, with a budget and the clearance of its motions."""
    cell = ClinicalCell(tmp_path_factory.mktemp("runs") / "20261121T000000-s3-abcd")
    cell.journal.write(Entry.OPENED, 0.0, theatre="mini scene, seed 3", banner="SIMULATED THEATRE")
    cell.carrying(MountedTool.STEREO_HEAD)
    closest = ClosestApproach(first="tube of the guide", second="stereo head", distance_mm=16.2, at=1.0)
    motions = tuple(
        MotionPreview(
            start="home",
            end=f"{FIRST}/fiducial {number}",
            kind="move",
            duration_s=1.0,
            clear=True,
            closest=closest,
            largest_joint_speed_share=0.5,
            largest_speed_mm_s=100.0,
            nearest_to_head_mm=50.0 * number,
        )
        for number in range(6)
    )
    paths = checked_paths(cell).model_copy(update={"motions": motions})
    steps = (*up_to_correspondence(cell), paths, relocalization(), registration.STEP, mounted_guide())
    engine = cell.begin(*steps)
    engine.run_to()
    engine.close("left")
    return write_report(cell.folder, truth=TRUTH)


def test_nothing_is_hidden_on_a_phone_and_all_of_it_can_be_read(page: Any, report: Path) -> None:
    assert misfits(page, report) == []
    assert page.requested == [report.as_uri()]


def test_the_verdict_is_on_the_first_screen_of_a_phone(page: Any, report: Path) -> None:
    page.set_viewport_size(PHONE_PX)
    page.goto(report.as_uri())
    verdict = page.locator("td.ok").first.bounding_box()
    assert verdict["y"] + verdict["height"] < PHONE_PX["height"]


def test_folded_parts_meant_for_paper_are_printed_and_nothing_is_cut_off(page: Any, report: Path) -> None:
    page.set_viewport_size({"width": A4_PX, "height": 1000})
    page.emulate_media(media="print")
    page.goto(report.as_uri())
    assert hidden_by_width(page) == []
    assert page.locator("details.paper table").first.bounding_box()["height"] > 0
    assert page.locator("details:not(.paper)").first.bounding_box() is None
    assert page.locator(".unprinted").is_visible()


def test_on_paper_headings_stay_with_what_follows_and_short_tables_whole(page: Any, report: Path) -> None:
    page.emulate_media(media="print")
    page.goto(report.as_uri())
    for selector, rule in (
        ("h2, h3, summary, thead", "breakAfter"),
        ("tr, .beside", "breakInside"),
        ("tbody > tr:last-child", "breakBefore"),
    ):
        assert set(page.eval_on_selector_all(selector, STYLES, rule)) == {"avoid"}
    assert set(page.eval_on_selector_all("thead", STYLES, "display")) == {"table-header-group"}


def test_a_case_sheet_is_two_pages_of_paper_and_a_comparison_fits_the_width(
    page: Any, report: Path, tmp_path: Path
) -> None:
    sheet = sheet_of_run(report.parent)
    assert sheet is not None
    compared = compare_runs(report.parent, report.parent).write(tmp_path / "comparison.html")
    for path, most_pages in ((sheet.write(tmp_path / "sheet.html"), 2), (compared, 3)):
        page.set_viewport_size({"width": A4_PX, "height": 1000})
        page.emulate_media(media="print")
        page.goto(path.as_uri())
        assert hidden_by_width(page) == []
        assert count_pages(page) <= most_pages
        page.emulate_media(media="screen")
        page.set_viewport_size(PHONE_PX)
        assert hidden_by_width(page) == []
