"""The rehearsal of the how-to, done as it is written there: a newcomer has nothing else."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from console_clicks import answer, run_by_clicks, take_seat

PAGE = Path(__file__).resolve().parents[3] / "docs" / "how-to" / "case" / "operate-in-the-browser.md"
HEADING = "## A rehearsal in two minutes"


@dataclass(frozen=True)
class Rehearsal:
    """What the numbered list says to type, press and choose."""

    arguments: tuple[str, ...]  # of the command
    patient: str
    step: str
    buttons: tuple[str, ...]  # in bold, in their order

    def follow(self, page: Any) -> list[str]:
        """Do it, from the seat to the end of the case; returns what was asked."""
        claim, following, run_to, run_on = self.buttons
        assert claim == "Take the seat"
        take_seat(page)
        asked = []
        while not asked:
            page.wait_for_selector("[data-do=next]:enabled, section.question h2")
            if page.locator("section.question h2").count():
                asked.append(answer(page, self.patient))
            else:
                before = page.locator("[data-do=next]").inner_text()
                page.get_by_role("button", name=re.compile(f"^{following}")).click()
                page.wait_for_function(
                    "before => document.querySelector('[data-do=next]').innerText !== before", arg=before
                )
        page.wait_for_selector("[data-do=run_to]:enabled")
        page.locator(".upto").click()
        page.get_by_role("option", name=self.step, exact=True).click()
        page.get_by_role("button", name=run_to, exact=True).click()
        while not any("registration" in subject for subject in asked):
            page.wait_for_selector("section.question h2")
            asked.append(answer(page, self.patient))
        page.wait_for_selector("[data-do=resume]:enabled")
        assert page.locator("[data-do=resume]").inner_text() == run_on
        return asked + run_by_clicks(page, patient=self.patient, run_on=True)


def rehearsal() -> Rehearsal:
    """As the page has it now."""
    section = PAGE.read_text(encoding="utf-8").partition(HEADING)[2].partition("\n## ")[0]
    steps = re.findall(r"^\d\. (.*(?:\n   .*)*)", section, re.M)
    codes = [re.findall(r"`([^`]+)`", step) for step in steps]
    command, *arguments = shlex.split(codes[0][0])
    assert command == "ronna-procedure"
    bold = re.findall(r"\*\*([^*]+)\*\*", section)
    return Rehearsal(tuple(arguments), codes[2][0], codes[3][0], tuple(bold))
