"""A console viewed for half an hour, by people who come and go, needs no more memory than at first."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from modest_chromium import MISSING, modest_chromium, opened_context
from scripted_engine import served_console

pytestmark = [pytest.mark.soak, pytest.mark.timeout(2400)]

MEGABYTE = 1e6


@dataclass(frozen=True)
class Minute:
    """Memory of its own at the end of a minute, and how many tabs had been opened and closed by then."""

    megabytes: float
    tabs: int


def memory_by_minute(folder: Path, minutes: int) -> list[Minute]:
    """One tab looks on all the time, others come and go."""
    found, tabs = [], 0
    with served_console(folder) as (process, address), modest_chromium(folder) as browser:
        context = opened_context(browser, viewport={"width": 1280, "height": 720})
        again = address.partition("?")[0] + "?low"
        watching = context.new_page()
        watching.goto(address + "&low")
        watching.wait_for_selector("#clock[data-beat]")
        for _ in range(minutes):
            ends_s = time.monotonic() + 60.0
            while time.monotonic() < ends_s:
                page = context.new_page()
                page.goto(again)
                page.wait_for_selector("#clock[data-beat]")
                page.close()
                tabs += 1
            found.append(Minute(process.memory_full_info().uss / MEGABYTE, tabs))
    return found


MINUTES = 30
SETTLED = 5  # minutes in which caches fill
MOST_GROWTH_MB = 15.0  # in all of the rest; a page that stayed would be a megabyte each, of hundreds


@pytest.mark.skipif(MISSING is not None, reason=MISSING or "")
def test_opening_and_closing_tabs_does_not_grow_the_memory_of_the_server(tmp_path: Path) -> None:
    found = memory_by_minute(tmp_path, MINUTES)
    assert found[-1].tabs > 100
    assert found[-1].megabytes - found[SETTLED - 1].megabytes < MOST_GROWTH_MB, found
