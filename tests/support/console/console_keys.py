"""Actions of an operator at the console's page with the keyboard alone."""

from __future__ import annotations

import contextlib
from typing import Any

from console_clicks import AGAIN_MS, ARMED_MS, HOLD_MS, IS_SETTLED, read_back

MOST_TABS = 60
HAS_FOCUS = "which => document.activeElement.matches(which)"
ANSWERS = "section.question .answers button"
TURN = f"""
() => document.querySelector("{ANSWERS}") || !document.querySelector("[data-do=resume]").disabled
  || document.querySelector(".state strong").innerText === "finished"
"""


def tab_to(page: Any, which: str) -> None:
    """Press Tab until that has the focus."""
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        if page.evaluate(HAS_FOCUS, which):
            return
    raise AssertionError(f"not reached by Tab: {which}")


def press(page: Any, which: str) -> None:
    """Go to a button by Tab and press it."""
    tab_to(page, which)
    page.keyboard.press("Enter")


def take_seat_by_keys(page: Any, name: str = "Dr Test") -> None:
    tab_to(page, "[aria-label='Your name']")
    page.keyboard.type(name)
    page.keyboard.press("Enter")
    page.wait_for_selector(f"text=You are operating as {name}")


def hold_space(page: Any) -> None:
    """Hold what has the focus for as long as it asks for."""
    page.wait_for_timeout(ARMED_MS)
    page.keyboard.down(" ")
    page.wait_for_timeout(HOLD_MS)
    page.keyboard.up(" ")


def answer_by_keys(page: Any) -> None:
    """Give the first answer to the question that stands, or that the case continues.

    Without effect where the page of a busy computer was grey for a moment: the question then stands on.
    """
    from playwright.sync_api import TimeoutError

    number = page.locator("section.question h2").get_attribute("data-question")
    if page.locator("section.question .typed input").count():
        tab_to(page, ".typed input")
        page.keyboard.press("Control+A")
        page.keyboard.type(read_back(page))
    goes_on = f"{ANSWERS}[data-answer=continue]"
    button = goes_on if page.locator(goes_on).count() else f"{ANSWERS}:first-child"
    is_held = "(press 1 s)" in page.locator(button).inner_text()
    tab_to(page, button)
    if is_held:
        hold_space(page)
    else:
        page.keyboard.press("Enter")
    with contextlib.suppress(TimeoutError):
        page.wait_for_function(IS_SETTLED, arg=number, timeout=AGAIN_MS)


def run_on_by_keys(page: Any) -> None:
    """To the end of the case."""
    while True:
        page.wait_for_function(TURN)
        if page.locator(".state strong").inner_text() == "finished":
            return
        if page.locator(ANSWERS).count():
            answer_by_keys(page)
        else:
            press(page, "[data-do=resume]")
            page.wait_for_function("document.querySelector('[data-do=resume]').disabled")
