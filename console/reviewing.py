"""Shows a finished case, or one run by another program: the same page, with a slider through its time."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

from console.app import serve_hub
from console.errors import NothingToShow
from console.feed.recorded import RecordedCase
from console.hub import Hub
from procedures.engine.events import Event
from procedures.engine.events.event_file import FollowedRun
from ronna_hw.command_line.messages import tell_address
from ronna_hw.command_line.viewers_address import ViewersAddress
from ronna_hw.errors import RonnaError


def review(folder: Path, port: int, viewers: ViewersAddress | None = None) -> None:
    """Serve until the command ends. Raises CON-001, CON-002, PRO-018."""
    try:
        followed = FollowedRun(folder)
    except RonnaError as error:
        raise NothingToShow(f"{folder} contains no run that can be shown: {error.what}") from error
    batches = followed.batches(whole=True)
    recorded, hub = RecordedCase(), Hub(folder)
    recorded.extend(next(batches))
    if not len(recorded):
        raise NothingToShow(f"{folder} has no events yet")
    hub.review = recorded
    hub.show(recorded.latest)

    async def work() -> None:
        loop = asyncio.get_running_loop()

        def take(events: list[Event]) -> None:
            recorded.extend(events)
            hub.heard()
            for event in events:
                hub.take(event)

        def follow() -> None:
            try:
                for events in batches:
                    loop.call_soon_threadsafe(take, list(events))
            except (RonnaError, OSError) as error:  # still being written; what was read before stays valid
                words = str(error) if isinstance(error, RonnaError) else f"{folder} cannot be read: {error}"
                loop.call_soon_threadsafe(hub.break_off, words)
            recorded.over = True

        threading.Thread(target=follow, name="follow the run", daemon=True).start()
        await asyncio.Event().wait()

    serve_hub(hub, port, work, tell_address, viewers)
