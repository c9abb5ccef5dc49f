"""Waiting for what a test awaits, in host time. The limit only ends a test that has failed."""

from __future__ import annotations

import time
from collections.abc import Callable

HANG_LIMIT_S = 30.0
STALL_OF_THE_COMPUTER_S = 10.0  # added to each limit that a command keeps: what the machine may take from it
LOOK_S = 0.005  # between two looks


def eventually(condition: Callable[[], bool], limit_s: float = HANG_LIMIT_S) -> None:
    """Return when the condition holds; AssertionError when it does not within `limit_s`."""
    deadline_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline_s, "the awaited condition did not come"
        time.sleep(LOOK_S)
