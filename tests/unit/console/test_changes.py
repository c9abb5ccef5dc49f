"""Pages wait for changes; a closed page stops waiting."""

from __future__ import annotations

import asyncio

import pytest

from console.changes import await_change

LONG_S = 600.0


async def _forever(changed: asyncio.Event) -> None:
    while True:
        await await_change(changed, LONG_S)


@pytest.mark.parametrize("steps", range(6))
def test_a_waiter_that_is_notified_and_cancelled_at_once_ends(steps: int) -> None:
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


def test_waiting_for_a_change_ends_on_timeout_and_on_a_change() -> None:
    async def both() -> bool:
        changed = asyncio.Event()
        await await_change(changed, 0.0)
        changed.set()
        await await_change(changed, LONG_S)
        return changed.is_set()

    assert not asyncio.run(both())
