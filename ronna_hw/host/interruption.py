"""The signals that end a program: work that they must not cut short, and work that they may always end.

A terminal sends Ctrl-C to its whole foreground group. What it means is decided by the program, not by the
processes that it started, so these never see it.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # Ctrl-C, an order, a closed terminal


@contextmanager
def interruption_deferred() -> Iterator[None]:
    """Hold back the signals that end a program until the block is left; for work bounded in time.

    Python delivers signals to the main thread only; in any other thread there is nothing to hold back.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[signal.Signals] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(signal.Signals(number))

    with _handled_by(note):
        yield
    for number in dict.fromkeys(received):
        signal.raise_signal(number)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let these signals end the block by KeyboardInterrupt, even if they are ignored around it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield


@contextmanager
def children_uninterrupted() -> Iterator[None]:
    """Start processes that never receive SIGINT, from their first moment on: they inherit it blocked.

    A session of their own, which hides the terminal's other signals, begins only after the fork.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def describe_exit(code: int) -> str:
    """How a process ended: the name of the signal that killed it, or its exit code."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:  # a real-time signal
        return f"killed by signal {-code}"


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """In the block, those signals go to `handler`; for the main thread."""
    before = {number: signal.signal(number, handler) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
