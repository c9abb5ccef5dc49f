"""Limit of a rate: a value passes at once, or the latest of those that come too soon when it is time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Generic, TypeVar

V = TypeVar("V")
EARLY_S = 0.1


class Throttle(Generic[V]):
    """Passes values on at most once per interval in the long run; a few may come early together.

    Values that a stall of this computer has delayed are not lost by that.
    """

    def __init__(self, interval_s: float, send: Callable[[V], None]) -> None:
        self._loop = asyncio.get_running_loop()
        self._interval_s = interval_s
        self._send = send
        self._next_s = 0.0  # loop time at which the next value is due by the rate alone
        self._timer: asyncio.TimerHandle | None = None
        self._latest: V

    def offer(self, value: V) -> None:
        """Pass a value on now, or keep it until the rate allows the next; a newer one replaces it."""
        self._latest = value
        if self._timer is None:
            wait_s = self._next_s - max(self._interval_s, EARLY_S) - self._loop.time()
            if wait_s <= 0.0:
                self._pass_on()
            else:
                self._timer = self._loop.call_later(wait_s, self._pass_on)

    def close(self) -> None:
        """Forget the value that waits."""
        if self._timer is not None:
            self._timer.cancel()

    def _pass_on(self) -> None:
        self._timer = None
        self._next_s = max(self._next_s, self._loop.time()) + self._interval_s
        self._send(self._latest)
