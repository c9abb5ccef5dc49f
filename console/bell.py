"""Subscribers waiting for a change notification."""

from __future__ import annotations

import asyncio


class Bell:
    """Pages subscribe with an event that is set when it rings."""

    def __init__(self) -> None:
        self._waiting: set[asyncio.Event] = set()

    def subscribe(self) -> asyncio.Event:
        """An event that is set whenever something changes."""
        event = asyncio.Event()
        self._waiting.add(event)
        return event

    def unsubscribe(self, event: asyncio.Event) -> None:
        """Remove the subscription."""
        self._waiting.discard(event)

    def tell(self) -> None:
        """Wake all subscribers."""
        for event in self._waiting:
            event.set()
