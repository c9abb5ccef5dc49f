"""A case operated from the console's page."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

import psutil
import pytest
from case_results import measured, outcome_of, targets
from console_clicks import ARMED_MS, answer, answer_until, await_next, run_to, take_seat
from console_keys import ANSWERS, answer_by_keys, hold_space, press, run_on_by_keys, tab_to, take_seat_by_keys
from modest_chromium import opened_context
from operated_case import OperatedCase, OperatedCases, enter
from rehearsal import rehearsal
from waiting import eventually

from procedures.journal.journal import JOURNAL_FILE, read_journal

SUSPENDED_S = 60.0


def test_a_whole_case_by_clicks_gives_bit_for_bit_the_results_of_a_run_without_a_console(
    start: OperatedCases, page: Any, alone: OperatedCase
) -> None:
    script = rehearsal()  # as the how-to has it: whoever follows it comes to the end
    case = start.typed(*script.arguments)
    enter(page, case.addresses["url"])
    asked = script.follow(page)
    assert [subject for subject in asked if "registration" in subject]
    case.ended()

    host = urlsplit(case.addresses["url"]).netloc
    assert {urlsplit(url).netloc for url in page.requested if not url.startswith(("data:", "blob:"))} == {
        host
    }
    assert page.complaints == []
    confirmations = [
        line for line in read_journal(case.run / JOURNAL_FILE) if line["entry"] == "confirmation"
    ]
    assert {line["by"] for line in confirmations} == {"Dr Test"}
    assert all(len(str(line["shown"])) == 64 for line in confirmations)

    assert measured(case.run) == measured(alone.run)
    assert targets(case.run) == targets(alone.run)


@pytest.mark.slow  # ten pages at once, drawn by the processors
def test_a_second_operator_and_eight_viewers_can_only_view_and_a_ninth_is_refused(
    start: OperatedCases, page: Any, browser: Any
) -> None:
    case = start("step")
    enter(page, case.addresses["url"] + "&low")
    take_seat(page, "Ana")
    contexts = [opened_context(browser) for _ in range(10)]
    other, *viewers, late = [context.new_page() for context in contexts]
    enter(other, case.addresses["url"] + "&low")
    other.wait_for_selector("text=Ana is operating; you are viewing")
    assert other.locator("[data-do=next]").is_disabled()
    forged = other.evaluate(
        """async () => (await fetch('/orders', {method: 'POST', body: JSON.stringify(
            {kind: 'next', upcoming: 'ct_import', nonce: 'forged-0001'})})).json()"""
    )
    assert forged == {"refused": "you are not in the operator's seat"}
    for viewer in viewers:
        enter(viewer, case.addresses["viewer_url"] + "&low")
        assert viewer.locator("[data-do=stop]").count() == 0
        assert viewer.get_by_label("Your name").is_visible() is False
    assert not any((case.run / "records").iterdir())
    with late.expect_websocket() as tried:
        late.goto(case.addresses["viewer_url"])
    eventually(lambda: tried.value.is_closed() or late.wait_for_timeout(50))
    assert late.locator("#clock[data-beat]").count() == 0
    for context in contexts:  # else they draw on beside all tests to come
        context.close()


def test_a_killed_console_is_shown_in_a_banner_over_the_past(start: OperatedCases, page: Any) -> None:
    case = start("step")
    enter(page, case.addresses["url"] + "&low")
    os.kill(case.console_pid, signal.SIGKILL)
    page.wait_for_selector("#lost:not([hidden])")
    page.wait_for_function("document.body.classList.contains('cut')")
    for shown in (page.locator("[data-do=stop]"), page.locator("[data-do=claim]")):
        assert shown.is_visible()
        assert shown.is_disabled()
    assert not [one for one in page.locator(".age").all() if one.is_visible()]
    assert "past" in page.evaluate("document.body.className")
    page.wait_for_selector("#popup[aria-hidden=false]", state="attached")
    assert not page.locator("#popup").is_visible()


@pytest.mark.slow  # a whole case, without any page
def test_the_case_continues_after_its_console_is_killed(start: OperatedCases) -> None:
    case = start("run", "--json")
    os.kill(case.console_pid, signal.SIGKILL)
    assert case.ended() == 0
    assert "the console has ended" in case.said
    assert outcome_of(case)["targets"]


def test_a_killed_engine_is_shown_in_a_banner_and_orders_are_refused(start: OperatedCases, page: Any) -> None:
    case = start("step")
    enter(page, case.addresses["url"])
    take_seat(page)
    await_next(page, "ct_import")
    os.kill(case.process.pid, signal.SIGKILL)
    page.wait_for_selector("text=THE ENGINE HAS ENDED")
    page.wait_for_function("document.body.classList.contains('past')")  # all grey
    assert page.locator("[data-do=next]").is_disabled()
    page.locator("[data-do=stop]").click()
    page.wait_for_selector("text=Refused: the engine has ended")


def test_by_keyboard_neither_enter_nor_a_stray_click_accepts_a_motion(
    start: OperatedCases, page: Any
) -> None:
    decline_by_keys(page, start("step"))


@pytest.mark.slow  # half of it is the test before
def test_a_whole_case_is_operated_by_keyboard(start: OperatedCases, page: Any) -> None:
    case = start("step")
    decline_by_keys(page, case)
    run_on_by_keys(page)
    assert case.ended() == 0
    assert page.complaints == []


def decline_by_keys(page: Any, case: OperatedCase) -> None:
    """From the seat to the first motion, which is accepted by nothing but holding the space bar."""
    enter(page, case.addresses["url"] + "&low")
    take_seat_by_keys(page)
    await_next(page, "ct_import")
    press(page, "[data-do=next]")
    await_next(page, "fiducial_localization")
    press(page, "[data-do=resume]")
    page.wait_for_selector(ANSWERS)
    while "then as listed" not in page.locator("section.question").inner_text():
        answer_by_keys(page)
        page.wait_for_selector(ANSWERS)

    tab_to(page, ".typed input")
    page.keyboard.type("0")
    page.wait_for_timeout(ARMED_MS)  # nothing on the page changes when it can be given
    page.locator(ANSWERS).first.click()
    page.locator(ANSWERS).first.focus()
    page.keyboard.press("Enter")
    page.wait_for_selector("text=Hold the button for one second")
    hold_space(page)
    page.wait_for_selector(".question >> text='0' is not it")
    page.wait_for_selector(".question >> text=2 tries left")
    assert not any((case.run / "records").glob("*-relocalization-T1.json"))
    press(page, f"{ANSWERS}:last-child")
    page.wait_for_selector(".notices >> text=PRO-002")
    assert page.complaints == []


@pytest.mark.slow  # a whole case at the pace of the clock
def test_a_suspended_browser_does_not_hold_up_the_case(start: OperatedCases, page: Any) -> None:
    case = start("run", "--json", "--speed", "1")  # else over before a slow page is open
    enter(page, case.addresses["viewer_url"])
    with _suspended_pages():
        assert case.process.poll() is None
        assert case.ended() == 0
    assert outcome_of(case)["targets"]


@pytest.mark.slow  # a minute by the clock
def test_the_step_ends_and_the_seat_is_freed_while_the_pages_are_suspended_for_a_minute(
    start: OperatedCases, page: Any, browser: Any
) -> None:
    case = start("step", "--speed", "1")
    enter(page, case.addresses["url"] + "&low")
    take_seat(page, "Ana")
    watching = opened_context(browser)
    viewer = watching.new_page()
    enter(viewer, case.addresses["viewer_url"] + "&low")
    await_next(page, "ct_import")
    run_to(page, "relocalization:T1")
    answer_until(page, "then as listed")
    answer(page)
    wakes_s = time.monotonic() + SUSPENDED_S

    def shown(entry: str) -> list[dict[str, Any]]:
        return [line for line in read_journal(case.run / JOURNAL_FILE) if line["entry"] == entry]

    with _suspended_pages():
        eventually(lambda: shown("result")[-1]["step"] == "relocalization:T1", SUSPENDED_S)
        eventually(lambda: [line["by"] for line in shown("seat")] == ["Ana", ""], SUSPENDED_S)
        eventually(lambda: time.monotonic() > wakes_s, 2 * SUSPENDED_S)
    for one in (page, viewer):
        one.wait_for_selector(".seat >> text=/seat is empty|no one is operating/")
    take_seat(page, "Ana")
    page.wait_for_selector("[data-do=next]:enabled")
    watching.close()


@contextlib.contextmanager
def _suspended_pages() -> Iterator[None]:
    ours = psutil.Process().children(recursive=True)
    renderers = [one for one in ours if _is_renderer(one)]
    assert renderers
    for renderer in renderers:
        renderer.suspend()
    try:
        yield
    finally:
        for renderer in renderers:
            renderer.resume()


def _is_renderer(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):  # it ends meanwhile
        return "--type=renderer" in " ".join(process.cmdline())
    return False
