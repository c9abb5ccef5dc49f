"""Pages wait for changes; one that is closed waits no longer."""

from __future__ import annotations

import asyncio

import pytest

from console.web.changes import changed_within

LONG_S = 600.0


async def _forever(changed: asyncio.Event) -> None:
    while True:
        await changed_within(changed, LONG_S)


@pytest.mark.parametrize("steps", range(6))
def test_whoever_is_told_and_ended_at_once_ends_whatever_comes_first(steps: int) -> None:
    async def ends() -> bool:
        changed = asyncio.Event()
        task = asyncio.create_task(_forever(changed))
        await asyncio.sleep(0)
        changed.set()
        for _ in range(steps):  # of the loop, between the news and the end
            await asyncio.sleep(0)
        task.cancel()
        done, _ = await asyncio.wait([task], timeout=1.0)
        return bool(done)

    assert asyncio.run(ends())


def test_it_comes_back_when_its_time_is_over_and_when_something_changed() -> None:
    async def both() -> bool:
        changed = asyncio.Event()
        await changed_within(changed, 0.0)
        changed.set()
        await changed_within(changed, LONG_S)
        return changed.is_set()

    assert not asyncio.run(both())
