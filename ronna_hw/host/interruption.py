"""The signals that end a program: work that they must not cut short, and work that they may always end."""

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
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """In the block, those signals go to `handler`; for the main thread."""
    before = {number: signal.signal(number, handler) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
