"""Actions of an operator at the console's page: take the seat, press Next, read back, hold a button."""

from __future__ import annotations

import re
from typing import Any

HOLD_MS = 1150  # the page asks for a second
ARMED_MS = 750
MOST_TRIES, AGAIN_MS = 4, 10_000
SEAT_IS_FREE = "document.querySelector('[data-do=claim]').checkVisibility()"
IS_SETTLED = "number => document.querySelector('section.question h2')?.dataset.question !== number"
PATIENT = "mini-3"  # as on the wristband of the phantom of the mini scene, seed 3


def await_next(page: Any, step: str) -> None:
    """Until the case waits for the operator, with that step as the next."""
    page.wait_for_selector(f"text=next: {step}")


def run_to(page: Any, step: str) -> None:
    """Order the steps up to and including that one."""
    page.locator(".upto").click()
    page.get_by_role("option", name=step, exact=True).click()
    page.locator("[data-do=run_to]").click()


def take_seat(page: Any, name: str = "Dr Test") -> None:
    page.get_by_label("Your name").fill(name)
    page.get_by_role("button", name="Take the seat").click()
    page.wait_for_selector(f"text=You are operating as {name}")


def keep_seat(page: Any) -> bool:
    """Take it again where a busy computer was silent for so long that it became free; whether that was so."""
    is_free = bool(page.locator("[data-do=claim]").is_visible())
    if is_free:
        take_seat(page)
    return is_free


def hold(page: Any, button: Any) -> None:
    """Press a button for as long as it asks for."""
    page.wait_for_timeout(ARMED_MS)
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.wait_for_timeout(HOLD_MS)
    page.mouse.up()


def answer(page: Any, patient: str = PATIENT) -> str:
    """Give the question that stands its first answer, or that the case continues; returns its subject.

    Given again where the page of a busy computer was grey for a moment, which empties what was typed.
    """
    from playwright.sync_api import Error

    heading = page.locator("section.question h2")
    subject, number = str(heading.inner_text()), heading.get_attribute("data-question")
    for tries_left in reversed(range(MOST_TRIES)):
        try:
            if not page.evaluate(IS_SETTLED, number):
                _give(page, patient)
            page.wait_for_function(IS_SETTLED, arg=number, timeout=AGAIN_MS if tries_left else None)
            break
        except Error:
            if not tries_left:
                raise
    return subject


def _give(page: Any, patient: str) -> None:
    question = page.locator("section.question")
    page.wait_for_function(f"document.querySelector('section.question .answers button') || {SEAT_IS_FREE}")
    keep_seat(page)
    typed = question.locator(".typed input")
    if typed.count():
        typed.fill(read_back(page, patient))
    answers = question.locator(".answers button")
    goes_on = question.locator(".answers button[data-answer=continue]")
    button = (
        goes_on if goes_on.count() else answers.first
    )  # to wait for an arm that hides the head is in vain
    if "(press 1 s)" in button.inner_text():
        hold(page, button)
    else:
        button.click()


def read_back(page: Any, patient: str = PATIENT) -> str:
    """Return the value that the open question wants read back."""
    moves = re.search(r"moves (\d+(?:\.\d+)?) mm", page.locator("section.question").inner_text())
    return moves[1] if moves else patient


def run_by_clicks(page: Any, *, patient: str = PATIENT, run_on: bool = False) -> list[str]:
    """To the end of the case, step by step or with `run_on`; returns what was asked."""
    button = "resume" if run_on else "next"
    asked = []
    ready = (
        "document.querySelector('section.question h2') || document.querySelector('.frozen')"
        " || !document.querySelector('[data-do=next]').disabled"
        " || document.querySelector('.state strong').innerText === 'finished'"
        f" || {SEAT_IS_FREE}"
    )
    while True:
        page.wait_for_function(ready)
        if keep_seat(page):
            continue
        if page.locator("section.question h2").count():
            asked.append(answer(page, patient))
        elif page.locator(".state strong").inner_text() == "finished":
            return asked
        else:
            before = page.locator("[data-do=next]").inner_text()
            page.locator(f"[data-do={button}]").click()
            page.wait_for_function(
                "before => document.querySelector('[data-do=next]').innerText !== before", arg=before
            )


def answer_until(page: Any, words: str, patient: str = PATIENT) -> None:
    """Answer whatever is asked before the question that says that."""
    page.wait_for_selector("section.question h2")
    while words not in page.locator("section.question").inner_text():
        answer(page, patient)
        page.wait_for_selector("section.question h2")
