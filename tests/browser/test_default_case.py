"""The default case by clicks, from the first to the last, with a fault that is explained and repaired."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Any

import pytest
from case_results import measured, targets
from console_clicks import answer, answer_until, await_next, run_by_clicks, run_to, take_seat
from operated_case import OperatedCase, OperatedCases, enter
from report_layout import misfits

from procedures.journal.journal import JOURNAL_FILE, read_journal
from ronna_hw.evidence.manifest import REPORT_FILE

DEFAULT = ("--scene", "default", "--seed", "7")
NO_TOOL, STEREO_HEAD = "0", "1"


def mount(case: OperatedCase, number: str) -> None:
    """Hang a tool on the arm, as the staff would; 0 takes it off."""
    control = re.findall(r"control port (\S+)", case.said)[0]
    line = [sys.executable, "-P", "-m", "sim.cli", "mount", number, "--control", control]
    subprocess.run(line, check=True, capture_output=True)


@pytest.mark.slow  # minutes; a mini case by clicks is for every submission
def test_the_default_case_by_clicks_with_a_fault_matches_the_run_without_fault_or_console(
    start: OperatedCases, page: Any
) -> None:
    case = start("step", scene=DEFAULT)
    enter(page, case.addresses["url"] + "&low")
    take_seat(page)
    await_next(page, "ct_import")
    run_to(page, "relocalization:T1")
    answer_until(page, "then as listed", patient="default-7")
    mount(case, NO_TOOL)  # somebody takes the stereo head off while the arm is about to move
    answer(page, patient="default-7")
    page.wait_for_selector(".state >> text=suspended")
    page.wait_for_selector("section.question >> text=mount the stereo head again")
    mount(case, STEREO_HEAD)
    assert page.locator(".answers button").first.get_attribute("data-answer") == "wait"
    answer(page, patient="default-7")

    asked = run_by_clicks(page, patient="default-7", run_on=True)
    assert [subject for subject in asked if "registration" in subject]
    case.ended()
    assert page.complaints == []
    rests = [line for line in read_journal(case.run / JOURNAL_FILE) if line["entry"] == "rested"]
    assert {line["state"] for line in rests} == {"suspended"}
    why = [str(line["reason"]).partition(":")[0] for line in rests]
    assert why[0] == "mounted tool"
    assert set(why[1:]) <= {"head"}  # the arm hides it at T3, for longer than the limit where hands are slow

    alone = start.without_console(DEFAULT)
    assert measured(case.run) == measured(alone.run)
    assert len(targets(case.run)) == 3
    assert targets(case.run) == targets(alone.run)
    assert misfits(page, alone.run / REPORT_FILE) == []
