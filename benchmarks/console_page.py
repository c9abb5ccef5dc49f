"""What the console's page costs, and how fast an event is on it, beside a bare page of the same library.

The engine is a script that sends a pose with its bodies at 20 Hz and a fact at 4 Hz; events are numbered by
the microsecond in which they were sent, so that the page itself can tell how late it is. Without Chromium
the server alone is measured, without pages.
"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

import psutil

from benchmarks.figures import Figure

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT / "tests" / "support") not in sys.path:
    sys.path.append(str(ROOT / "tests" / "support"))

from modest_chromium import MISSING, modest_chromium  # noqa: E402

PERIOD_S = 0.05
FACT_EVERY = 5  # poses
SETTLING_S, MEASURED_S = 3.0, 8.0
READY_S = 30.0
TABS = (0, 1, 3)
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


def measure() -> list[Figure]:
    """Processor share of the server and delay of an event, by open pages."""
    figures = []
    with tempfile.TemporaryDirectory() as place:
        began_s = time.monotonic()
        with _console(Path(place)) as (process, address):
            ready_s = time.monotonic() - began_s
            ours = _by_tabs(process, address, Path(place))
        with _bare() as (process, address):
            bare = _by_tabs(process, address, Path(place))
    figures.append(Figure("start of the console's server", OURS, ready_s, "s").at_most(3.0))
    most_percent, most_ms = {1: 10.0, 3: 30.0}, {1: 20.0, 3: 120.0}
    for tabs, (share_percent, late_ms) in ours.items():
        floor = bare[tabs]
        ratio = share_percent / floor[0] if floor[0] else None
        cpu = Figure(f"processor share of the server, {tabs} pages", OURS, share_percent, "%", ratio, BARE)
        figures.append(cpu.at_most(most_percent[tabs]) if tabs in most_percent else cpu)
        figures.append(Figure(cpu.what, BARE, floor[0], "%"))
        if late_ms:
            late = _late(tabs, OURS, late_ms)
            figures += [late.at_most(most_ms[tabs]), _late(tabs, BARE, floor[1])]
    return figures


def _late(tabs: int, who: str, late_ms: list[float]) -> Figure:
    p95_ms = sorted(late_ms)[int(0.95 * len(late_ms))]
    return Figure(f"fact to page, {tabs} pages", who, median(late_ms), "ms", more={"p95": p95_ms})


def _by_tabs(process: psutil.Process, address: str, place: Path) -> dict[int, tuple[float, list[float]]]:
    if MISSING:
        return {0: (_share_percent(process), [])}
    found = {}
    with modest_chromium(place) as browser:
        context, pages = browser.new_context(viewport={"width": 1280, "height": 720}), []
        context.add_init_script(LATE)
        for tabs in TABS:
            while len(pages) < tabs:
                page = context.new_page()
                page.goto(address if not pages else address.partition("?")[0] + "?low")
                page.wait_for_selector("#clock", state="attached")
                pages.append(page)
            time.sleep(SETTLING_S)
            for page in pages:
                page.evaluate("window.late = []")
            share = _share_percent(process)
            found[tabs] = (share, [late for page in pages for late in page.evaluate("window.late")])
    return found


def _share_percent(process: psutil.Process) -> float:
    before = sum(process.cpu_times()[:2])
    time.sleep(MEASURED_S)
    return float(100.0 * (sum(process.cpu_times()[:2]) - before) / MEASURED_S)


@contextmanager
def _console(place: Path) -> Iterator[tuple[psutil.Process, str]]:
    ours, theirs = socket.socketpair()
    line = [sys.executable, "-P", "-m", "console.serving", "--feed", str(theirs.fileno()), str(place)]
    with theirs:
        child = subprocess.Popen(line, stdout=subprocess.PIPE, text=True, pass_fds=[theirs.fileno()])
    over = threading.Event()
    sender = threading.Thread(target=_send, args=(ours, over))
    try:
        assert child.stdout is not None
        ready = json.loads(child.stdout.readline().removeprefix("READY "))
        sender.start()
        yield psutil.Process(child.pid), ready["viewer_url"]
    finally:
        over.set()
        if sender.is_alive():
            sender.join()
        ours.close()
        child.kill()
        child.wait()


def _send(ours: socket.socket, over: threading.Event) -> None:
    from procedures.engine.events import Bodies, Body, JournalLine, Order, OrderedStep, Pose

    step = OrderedStep(step="relocalization:T1", title="A step", phase="operation", moves=True)
    _event(ours, Order(steps=(step,) * 13))
    body = Body(name="link", radius_mm=50.0)
    fixed = Body(name="table", radius_mm=50.0, ends_mm=(0, 0, 0, 100, 0, 0))
    pairs = tuple((moving, other) for moving in range(9) for other in range(12))
    _event(ours, Bodies(moving=(body,) * 9, fixed=(fixed,) * 12, pairs=pairs))
    count = 0
    while not over.wait(PERIOD_S):
        count += 1
        place = (float(count % 500), 0.0, 500.0, float(count % 500), 300.0, 500.0)
        _event(ours, Pose(arm="arm", joints_rad=(0.0,) * 6, age_s=0.0, bodies_mm=(place,) * 9))
        if count % FACT_EVERY == 0:
            _event(ours, JournalLine(line={"entry": "motion", "sequence": count}))


def _event(ours: socket.socket, what: Any) -> None:
    from procedures.engine.events import Event

    now_us = time.time_ns() // 1000
    event = Event(number=now_us, host_time=datetime.now(UTC), theatre_time_s=now_us / 1e6, what=what)
    ours.sendall(f'{{"event":{event.model_dump_json()}}}\n'.encode())


@contextmanager
def _bare() -> Iterator[tuple[psutil.Process, str]]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    program = Path(__file__).parent / "peers" / "bare_page.py"
    child = subprocess.Popen(
        [sys.executable, "-P", str(program), str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        deadline_s = time.monotonic() + READY_S
        while time.monotonic() < deadline_s:
            with socket.socket() as knock:
                if knock.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        yield psutil.Process(child.pid), f"http://127.0.0.1:{port}/"
    finally:
        child.kill()
        child.wait()
