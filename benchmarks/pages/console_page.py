"""CPU cost and event latency of the console page, against a bare page built with the same library.

The engine is a script; its events are numbered by the microsecond in which they were sent, so that the page
itself can measure its delay. Without Chromium only the server is measured, without pages. Then a case in real
time, with and without the console.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any
from urllib.request import urlopen

import psutil

from benchmarks.figures import Figure

ROOT = Path(__file__).resolve().parents[2]
sys.path += map(str, (ROOT / "tests" / "support").iterdir())

# These are in the tests' folders, which are on the path only now.
from modest_chromium import MISSING, modest_chromium, opened_context  # noqa: E402
from scripted_engine import served_console  # noqa: E402

from benchmarks.pages import console_case  # noqa: E402  # it also needs the modules beside the tests

MEASURED_S = 8.0  # over which CPU time is counted
SETTLED_FACTS = 8  # that a page must have shown before it counts
READY_S = 30.0
TABS = (0, 1, 3)
SMALLEST_TABS, SMALLEST_S = (0, 1), 1.0
OURS, BARE = "console", "bare page"
LATE = """
window.late = [];
new MutationObserver(() => {
  const clock = document.getElementById("clock");
  const number = clock && (clock.dataset.fact || clock.dataset.n);
  if (!number || number === window.seen) return;
  window.seen = number;
  window.late.push(performance.timeOrigin + performance.now() - Number(number) / 1000);
}).observe(document, {childList: true, subtree: true, attributes: true});
"""


def measure(smallest: bool = False) -> list[Figure]:
    tabs_open, duration_s = (SMALLEST_TABS, SMALLEST_S) if smallest else (TABS, MEASURED_S)
    figures = []
    with tempfile.TemporaryDirectory() as place:
        began_s = time.monotonic()
        with served_console(Path(place)) as (process, address):
            ready_s = time.monotonic() - began_s
            ours = _measure_by_tabs(process, address, Path(place), tabs_open, duration_s)
        with bare_page() as (process, address):
            bare = _measure_by_tabs(process, address, Path(place), tabs_open, duration_s)
    figures.append(Figure("start of the console's server", OURS, ready_s, "s").at_most(3.0))
    most_percent, most_ms = {1: 10.0, 3: 30.0}, {1: 20.0, 3: 120.0}
    for tabs, (share_percent, late_ms) in ours.items():
        floor = bare[tabs]
        ratio = share_percent / floor[0] if floor[0] else None
        cpu = Figure(f"processor share of the server, {tabs} pages", OURS, share_percent, "%", ratio, BARE)
        figures.append(cpu.at_most(most_percent[tabs]) if tabs in most_percent else cpu)
        figures.append(Figure(cpu.what, BARE, floor[0], "%"))
        if late_ms:
            late = _late_figure(tabs, OURS, late_ms)
            figures += [late.at_most(most_ms[tabs]), _late_figure(tabs, BARE, floor[1])]
    return figures + console_case.measure("max" if smallest else "1")


def _late_figure(tabs: int, who: str, late_ms: list[float]) -> Figure:
    p95_ms = sorted(late_ms)[int(0.95 * len(late_ms))]
    return Figure(f"fact to page, {tabs} pages", who, median(late_ms), "ms", more={"p95": p95_ms})


def _measure_by_tabs(
    process: psutil.Process, address: str, place: Path, tabs_open: tuple[int, ...], duration_s: float
) -> dict[int, tuple[float, list[float]]]:
    if MISSING:
        return {0: (_measure_share_percent(process, duration_s), [])}
    found = {}
    pages: list[Any] = []
    with modest_chromium(place) as browser:
        context = opened_context(browser, viewport={"width": 1280, "height": 720})
        context.add_init_script(LATE)
        for tabs in tabs_open:
            while len(pages) < tabs:
                page = context.new_page()
                page.goto(address if not pages else address.partition("?")[0] + "?low")
                page.wait_for_selector("#clock", state="attached")
                pages.append(page)
            for page in pages:
                page.evaluate("window.late = []")
            for page in pages:
                page.wait_for_function(f"window.late.length >= {SETTLED_FACTS}")
                page.evaluate("window.late = []")
            share = _measure_share_percent(process, duration_s)
            found[tabs] = (share, [late for page in pages for late in page.evaluate("window.late")])
    return found


def _measure_share_percent(process: psutil.Process, duration_s: float) -> float:
    before = sum(process.cpu_times()[:2])
    time.sleep(duration_s)
    return float(100.0 * (sum(process.cpu_times()[:2]) - before) / duration_s)


@contextmanager
def bare_page() -> Iterator[tuple[psutil.Process, str]]:
    program = Path(__file__).parents[1] / "peers" / "bare_page.py"
    with socket.create_server(("127.0.0.1", 0)) as listening:
        number = listening.fileno()
        address = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        child = subprocess.Popen(
            [sys.executable, "-P", str(program), str(number)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[number],
        )
    try:
        urlopen(address, timeout=READY_S).close()
        yield psutil.Process(child.pid), address
    finally:
        child.kill()
        child.wait()
