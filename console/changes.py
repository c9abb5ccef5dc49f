"""Change notification for the pages of a case or a plan."""

from __future__ import annotations

import asyncio
import contextlib


class ChangeNotifier:
    """Notifies subscribed pages by setting each subscriber's event on every change."""

    def __init__(self) -> None:
        self._waiting: set[asyncio.Event] = set()

    def subscribe(self) -> asyncio.Event:
        """Return an event that is set whenever something changes."""
        event = asyncio.Event()
        self._waiting.add(event)
        return event

    def unsubscribe(self, event: asyncio.Event) -> None:
        self._waiting.discard(event)

    def notify(self) -> None:
        for event in self._waiting:
            event.set()


async def await_change(changed: asyncio.Event, limit_s: float) -> None:
    """Wait until the event is set or the time limit expires, then clear the event.

    Not with `asyncio.wait_for`: before Python 3.12 it loses a cancellation if the event is set at that
    moment, and the page of a closed tab would be updated for ever.
    """
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            await changed.wait()
    changed.clear()
