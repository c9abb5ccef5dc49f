"""Reviewing a finished case in the browser."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from operated_case import READY_S, OperatedCases, enter
from page_reading import low_contrast_by_scheme, not_reached_by_tab, without_name
from waiting import eventually


def test_a_finished_case_can_be_reviewed_back_to_its_first_event(
    start: OperatedCases, page: Any, tmp_path: Path
) -> None:
    case = start("run", "--json")
    assert case.ended() == 0
    errors = tmp_path / "review-errors"
    with errors.open("w") as file:
        line = [sys.executable, "-P", "-m", "console.command", str(case.run)]
        process = subprocess.Popen(line, stderr=file, stdin=subprocess.DEVNULL)
    try:
        eventually(lambda: "CONSOLE {" in errors.read_text(), READY_S)
        enter(page, json.loads(re.findall(r"CONSOLE (\{.*\})", errors.read_text())[0])["url"])
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
        assert page.complaints == []
    finally:
        process.terminate()
        process.wait(10)
