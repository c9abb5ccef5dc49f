"""Waiting for something to change, but not for ever."""

from __future__ import annotations

import asyncio
import contextlib


async def changed_within(changed: asyncio.Event, limit_s: float) -> None:
    """Return when the event is set, or after the limit; the event is clear then."""
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(changed.wait(), limit_s)
    changed.clear()
