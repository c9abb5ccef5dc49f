"""Waits for something to change, but not for ever."""

from __future__ import annotations

import asyncio
import contextlib


async def changed_within(changed: asyncio.Event, limit_s: float) -> None:
    """Return when the event is set, or after the limit; the event is then clear.

    Not with `asyncio.wait_for`: before Python 3.12 it loses a cancellation if the event is set at that
    moment, and the page of a closed tab would be updated for ever.
    """
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            await changed.wait()
    changed.clear()
