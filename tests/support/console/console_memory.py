"""What a console's server needs while tabs are opened and closed, minute by minute."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from modest_chromium import modest_chromium, opened_context
from scripted_engine import served_console

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
