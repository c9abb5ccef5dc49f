"""Reviewing a finished case in the browser."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from console_clicks import await_next
from operated_case import OperatedCase, OperatedCases, enter, reviewed
from page_reading import (
    MOST_FIRST_PICTURE_MS,
    cut_labels,
    first_picture_ms,
    low_contrast_by_scheme,
    not_reached_by_tab,
    too_wide_by_screen,
    without_name,
)

from ronna_hw.log_output import LOG_FILE

COVERED = ".skinbox path[stroke='rgb(20,110,60)']"


def test_a_finished_case_can_be_reviewed_back_to_its_first_event(
    page: Any, tmp_path: Path, alone: OperatedCase
) -> None:
    with reviewed(alone.run, tmp_path / "review-errors") as address:
        enter(page, address)
        page.wait_for_selector(".state >> text=finished")
        assert page.locator("[data-do]:visible").count() == 0
        page.wait_for_selector(".accuracy >> text=Predicted error at the targets")
        slider = page.locator(".moment .q-slider").bounding_box()
        page.mouse.click(slider["x"] + 3, slider["y"] + slider["height"] / 2)
        page.wait_for_selector(".accuracy >> text=No registration yet")
        page.get_by_label("next event").click()
        assert low_contrast_by_scheme(page) == {}
        assert without_name(page) == []
        assert not_reached_by_tab(page) == []
        assert too_wide_by_screen(page) == {}
        assert cut_labels(page) == []
        assert first_picture_ms(page, page.url) < MOST_FIRST_PICTURE_MS
        errors = (tmp_path / "review-errors").read_text()
        for shown in (page.title(), page.url, alone.said, errors, (alone.run / LOG_FILE).read_text()):
            assert "Phantom" not in shown  # as the CT calls the patient
        assert page.complaints == []


@pytest.mark.slow  # the page of a case under way says the same
def test_a_case_that_is_killed_while_it_is_reviewed_is_shown_as_ended(
    start: OperatedCases, page: Any, tmp_path: Path
) -> None:
    case = start("step")
    with reviewed(case.run, tmp_path / "review-errors") as address:
        enter(page, address)
        await_next(page, "ct_import")
        assert page.locator(".frozen").count() == 0
        os.kill(case.process.pid, signal.SIGKILL)
        page.wait_for_selector("text=THE ENGINE HAS ENDED")
        page.wait_for_function("document.body.classList.contains('past')")


@pytest.mark.slow  # a whole case
def test_the_skin_is_drawn_with_what_a_scan_has_covered_while_it_runs_and_in_review(
    start: OperatedCases, page: Any, tmp_path: Path
) -> None:
    case = start("run", "--json", "--fiducials", "surface", scene=("--scene", "mini", "--seed", "7"))
    enter(page, case.addresses["viewer_url"] + "&low")
    page.wait_for_function("document.querySelector('.skinbox img')?.naturalWidth > 0")
    page.wait_for_selector("figure.live >> text=stereo head")
    page.wait_for_selector(COVERED)
    few = marked(page)
    page.reload()
    page.wait_for_selector(COVERED)
    assert marked(page) >= few
    assert case.ended() == 0
    with reviewed(case.run, tmp_path / "review-errors") as address:
        enter(page, address)
        page.wait_for_selector(".skinbox >> text=12 of 12")
        page.wait_for_function("document.querySelector('.skinbox img')?.naturalWidth > 0")
        assert marked(page) > few
        assert page.complaints == []


def marked(page: Any) -> int:
    """Return how many places of the skin are marked as covered."""
    return sum(one.get_attribute("d").count("M") for one in page.locator(COVERED).all())
