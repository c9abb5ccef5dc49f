"""A page that everybody can read and use: contrast, names, keyboard, small screens, no 3-D."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any

import cv2
import numpy as np
import pytest
from console_clicks import take_seat
from operated_case import enter
from page_reading import (
    NO_WEBGL,
    cut_labels,
    low_contrast,
    low_contrast_by_scheme,
    not_reached_by_tab,
    too_wide,
    too_wide_by_screen,
    tops_px,
    without_name,
)
from scripted_engine import served_at

from procedures.engine.events import (
    Advisory,
    Answered,
    CaseState,
    DeviceFact,
    DeviceState,
    EventContent,
    ExpectedError,
    Fault,
    JournalLine,
    LinkHealth,
    Progress,
    Questioned,
    Refusal,
    ScanProgress,
    StepState,
    Waiting,
)
from procedures.operator.question import Evidence, Picture, PredictedError

OPENED = JournalLine(line={"entry": "opened", "run": "r1", "banner": "SIMULATED THEATRE", "theatre": "mini"})
LINK = LinkHealth(cycles=100, late=1, lost=0, rejected=0, turnaround_median_us=20.0, turnaround_p99_us=90.0)
EVENTFUL = (
    OPENED,
    CaseState(state="held", reason="the robot stopped"),
    StepState(step="relocalization:T1", state="failed", summary="sphere 2 was lost"),
    DeviceState(
        device="arm",
        state="fault",
        fault="RSI-010: stopped",
        says=(
            DeviceFact(name="operating mode", found="T1"),
            DeviceFact(name="guard", found="open", ready=False),
        ),
        notices=("an old firmware",),
    ),
    DeviceState(device="tracker", state="active"),
    LINK,
    Fault(code="RSI-010", what="it stopped", advice="Look."),
    Refusal(step="relocalization:T1", unmet=("the arm is in fault",)),
    Advisory(text="the wall clock jumped"),
)
QUESTION = Questioned(
    question=1,
    topic="registration",
    subject="accept the registration",
    value="moves 12 mm",
    answers=("yes", "no"),
    timeout_s=None,
    evidence=(Evidence(title="budget", head=("source", "mm"), rows=(("stereo", "0.1"),)),),
    read_back="how many mm it moves",
    reads=("gap in mm",),
    deliberate=True,
)
CLEAR_OF_THE_HEAD = """
which => {
  const top = document.querySelector(which).getBoundingClientRect().top;
  return top >= document.querySelector(".head").getBoundingClientRect().bottom && top < window.innerHeight;
}
"""
ALL_IN_VIEW = """
which => [...document.querySelectorAll(which)].every(one => {
  const {left, right, top, bottom} = one.getBoundingClientRect();
  const ends = [left + 2, right - 2].map(x => document.elementFromPoint(x, (top + bottom) / 2));
  const inside = left >= 0 && right <= window.innerWidth && top >= 0 && bottom <= window.innerHeight;
  return inside && ends.every(end => one.contains(end));
})
"""
# The page looks every 250 ms for a new question and brings it into view once; the scrolling comes after that.
TWO_TICKS_MS = 500
SCROLLED_AND_STAYS = """
px => {
  const stays = window.scrollY > px;
  if (document.querySelector(".answers button")) window.scrollTo(0, px + 100);
  return stays;
}
"""
DECISION, PICTURES, RECORDS = (".ask", ".orders"), (".scenebox", ".picturebox"), (".journalbox", ".logbox")
SCREENS = ((390, 844), (1280, 800))
WAITING = Waiting(upcoming="relocalization:T1", unmet=("the arm is in fault",))


@pytest.mark.parametrize(
    "last",
    [pytest.param(QUESTION, id="asked"), pytest.param(WAITING, id="waiting", marks=pytest.mark.slow)],
)
def test_the_console_is_readable_on_a_phone_and_a_screen_with_stop_beside_the_banner_and_all_keys_reached(
    page: Any, tmp_path: Path, last: Questioned | Waiting
) -> None:
    with served_at(tmp_path, content=(*EVENTFUL, last)) as (_, addresses):
        enter(page, addresses["url"] + "&low")
        page.wait_for_selector(".advicebox, section.question:not(.hidden)")
        assert low_contrast(page) == []
        assert cut_labels(page) == []
        take_seat(page)
        assert low_contrast_by_scheme(page) == {}
        assert without_name(page) == []
        assert not_reached_by_tab(page) == []
        for width, height in SCREENS:
            page.set_viewport_size({"width": width, "height": height})
            assert too_wide(page) == 0
            assert cut_labels(page) == []
            decision, pictures, records = (tops_px(page, *which) for which in (DECISION, PICTURES, RECORDS))
            assert max(decision) < height
            assert max(*decision, *pictures) < min(records)
            page.mouse.wheel(0, 3000)
            stop, banner = (page.locator(one).bounding_box() for one in ("[data-do=stop]", ".banner"))
            assert 0 <= stop["x"] <= stop["x"] + stop["width"] <= width
            assert 0 <= stop["y"] < stop["y"] + stop["height"] <= height
            assert stop["y"] < banner["y"] + banner["height"] / 2 < stop["y"] + stop["height"]  # one row
            page.mouse.wheel(0, -3000)


def test_the_error_against_the_margin_and_the_answers_are_in_view_also_over_an_unfolded_budget(
    page: Any, tmp_path: Path
) -> None:
    picture = cv2.imencode(".png", np.zeros((267, 813), np.uint8))[1].tobytes()  # as large as real cuts
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "plan-T1.png").write_bytes(picture)
    rows = tuple((f"source {number}", "0.1") for number in range(60))
    predicted = PredictedError(target="T1", rms_mm=0.46, limit_mm=0.83, confidence=0.95, margin_mm=2.0)
    asked = QUESTION.model_copy(
        update={
            "evidence": (Evidence(title="budget", head=("source", "mm"), rows=rows),),
            "predicted": (predicted,),
            "pictures": (Picture(name="plan-T1.png", sha256=hashlib.sha256(picture).hexdigest()),),
        }
    )
    with served_at(tmp_path, content=(OPENED, asked)) as (_, addresses):
        enter(page, addresses["url"] + "&low")
        take_seat(page)
        page.wait_for_function("document.querySelector('.question img').naturalWidth === 813")
        page.wait_for_selector(".accuracy >> text=Not accepted yet: T1")
        for width, height, decides in (
            (1280, 800, ".decides dd, .question img, .answers button, .stage"),
            (390, 844, ".decides dd, .answers button"),
        ):
            page.set_viewport_size({"width": width, "height": height})
            page.evaluate("window.scrollTo(0, 0)")
            page.wait_for_function(ALL_IN_VIEW, arg=decides)
            boxes = [one.bounding_box() for one in page.locator(".question img").all()]
            assert [box["width"] for box in boxes] == [pytest.approx(box["height"], abs=1.0) for box in boxes]
            columns, rows = ({round(box[along]) for box in boxes} for along in "xy")
            assert (len(columns), len(rows)) == ((3, 1) if width == 1280 else (1, 3))
            page.locator(".evidence summary").click()
            page.wait_for_function(ALL_IN_VIEW, arg=".answers button")
            page.locator(".evidence summary").click()


def test_a_question_that_follows_a_longer_one_is_brought_into_view_and_no_focus_lies_under_the_head(
    page: Any, tmp_path: Path
) -> None:
    lines = "\n".join(f"statement {number}" for number in range(60))
    longer = QUESTION.model_copy(update={"value": lines})
    shorter = QUESTION.model_copy(update={"question": 2, "subject": "park the arm", "evidence": ()})
    answered = Event()

    def content() -> Iterator[EventContent]:
        yield from (OPENED, longer)
        while not answered.wait(0.1):
            yield LINK  # an engine that waits is not silent
        yield Answered(question=1, answer="yes", by="Dr Test")
        yield shorter

    with served_at(tmp_path, content=content()) as (_, addresses):
        enter(page, addresses["url"] + "&low")
        take_seat(page)
        page.wait_for_function(SCROLLED_AND_STAYS, arg=500, polling=TWO_TICKS_MS)
        answered.set()
        page.wait_for_selector("section.question >> text=park the arm")
        page.wait_for_function(CLEAR_OF_THE_HEAD, arg="section.question")
        page.mouse.wheel(0, 400)
        page.wait_for_function("window.scrollY > 150")
        page.locator(".typed input").first.focus()
        page.wait_for_function(CLEAR_OF_THE_HEAD, arg=".typed input")


def test_a_scan_of_the_skin_grows_look_by_look_stays_after_a_reload_and_fits_a_phone(
    page: Any, tmp_path: Path
) -> None:
    second_look = Event()

    def content() -> Iterator[EventContent]:
        yield from (OPENED, StepState(step="surface_scan", state="begun"), scanned(None))
        while not second_look.wait(0.1):
            yield LINK
        yield scanned(None, 0.83)

    with served_at(tmp_path, content=content()) as (_, addresses):
        enter(page, addresses["viewer_url"] + "&low")
        page.wait_for_selector(".skinbox >> text=too little scanned")
        second_look.set()
        page.wait_for_selector(".skinbox >> text=0.83")
        page.reload()
        page.wait_for_selector(".skinbox >> text=0.83")
        assert page.url.endswith("/?low")
        assert low_contrast_by_scheme(page) == {}
        assert without_name(page) == []
        assert too_wide_by_screen(page) == {}
        page.set_viewport_size({"width": 390, "height": 844})
        step, scan, chart = (page.locator(one).bounding_box() for one in (".advicebox", ".skinbox", ".chart"))
        assert 0 <= scan["y"] - (step["y"] + step["height"]) < 20
        assert scan["y"] < chart["y"]


def scanned(*rms_mm: float | None) -> Progress:
    """Return a scan after as many looks, with the error at a target after each."""
    scan = ScanProgress(
        looks_done=len(rms_mm),
        looks_planned=3,
        covered_share=0.3 * len(rms_mm),
        predicted_error_mm=rms_mm[-1],
        expected=(ExpectedError(target="T1", rms_mm=rms_mm),),
    )
    return Progress(step="surface_scan", share=0.5, text="", scan=scan)


def test_without_webgl_the_panels_work_and_the_scene_explains_why_it_is_empty(
    page: Any, tmp_path: Path
) -> None:
    page.add_init_script(NO_WEBGL)
    with served_at(tmp_path, content=(*EVENTFUL, WAITING)) as (_, addresses):
        enter(page, addresses["url"])
        take_seat(page)
        beat = page.locator("#clock").get_attribute("data-beat")
        page.wait_for_function("beat => document.getElementById('clock').dataset.beat !== beat", arg=beat)
        page.wait_for_selector(".scenebox >> text=WebGL")
        assert page.locator(".devicebox >> text=RSI-010").is_visible()
