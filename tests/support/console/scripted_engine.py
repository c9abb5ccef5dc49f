"""A console's server fed by a script in place of an engine: poses at 20 Hz, a fact at 4 Hz."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil

from procedures.engine.events import (
    Bodies,
    Body,
    Event,
    EventContent,
    JournalLine,
    Order,
    OrderedStep,
    Pose,
    Seat,
)
from procedures.runs.orders import Claim, OrderReply, read_order

PERIOD_S = 0.05
FACT_EVERY = 5  # poses


@contextmanager
def served_console(place: Path) -> Iterator[tuple[psutil.Process, str]]:
    """The server's process and its address for viewers; both sides end with the block."""
    with served_at(place) as (process, addresses):
        yield process, addresses["viewer_url"]


@contextmanager
def served_at(
    place: Path, *more: str, content: Iterable[EventContent] = ()
) -> Iterator[tuple[psutil.Process, dict[str, str]]]:
    """As `served_console`, with all addresses and `more` arguments; `content` happens first.

    It carries no order out, but whoever claims the seat has it.
    """
    ours, theirs = socket.socketpair()
    line = [sys.executable, "-P", "-m", "console.serving", "--feed", str(theirs.fileno()), *more, str(place)]
    with theirs:
        child = subprocess.Popen(line, stdout=subprocess.PIPE, text=True, pass_fds=[theirs.fileno()])
    over = threading.Event()
    sender = threading.Thread(target=_send, args=(ours, over, content))
    threading.Thread(target=_reply, args=(ours,), daemon=True).start()
    try:
        assert child.stdout is not None
        ready = json.loads(child.stdout.readline().removeprefix("READY "))
        sender.start()
        yield psutil.Process(child.pid), ready
    finally:
        over.set()
        if sender.is_alive():
            sender.join()
        ours.close()
        child.kill()
        child.wait()
        if child.stdout is not None:
            child.stdout.close()


def _reply(ours: socket.socket) -> None:
    """Until the other side has gone."""
    with contextlib.suppress(OSError, ValueError), ours.makefile("rb") as lines:
        for line in lines:
            sent = read_order(line)
            if isinstance(sent.order, Claim):
                _event(ours, Seat(holder=sent.order.name))
            ours.sendall(OrderReply(nonce=sent.nonce).model_dump_json().encode() + b"\n")


def _send(ours: socket.socket, over: threading.Event, content: Iterable[EventContent]) -> None:
    """Events are numbered by the microsecond in which they are sent: a page can tell how late it is."""
    step = OrderedStep(step="relocalization:T1", title="A step", phase="operation", moves=True)
    _event(ours, Order(steps=(step,) * 13))
    body = Body(name="link", radius_mm=50.0)
    fixed = Body(name="table", radius_mm=50.0, ends_mm=(0, 0, 0, 100, 0, 0))
    pairs = tuple((moving, other) for moving in range(9) for other in range(12))
    _event(ours, Bodies(moving=(body,) * 9, fixed=(fixed,) * 12, pairs=pairs))
    for what in content:
        if over.is_set():
            return
        _event(ours, what)
    count = 0
    while not over.wait(PERIOD_S):
        count += 1
        place = (float(count % 500), 0.0, 500.0, float(count % 500), 300.0, 500.0)
        _event(ours, Pose(arm="arm", joints_rad=(0.0,) * 6, age_s=0.0, bodies_mm=(place,) * 9))
        if count % FACT_EVERY == 0:
            _event(ours, JournalLine(line={"entry": "motion", "sequence": count}))


def _event(ours: socket.socket, what: Any) -> None:
    now_us = time.time_ns() // 1000
    event = Event(number=now_us, host_time=datetime.now(UTC), theatre_time_s=now_us / 1e6, what=what)
    ours.sendall(f'{{"event":{event.model_dump_json()}}}\n'.encode())
