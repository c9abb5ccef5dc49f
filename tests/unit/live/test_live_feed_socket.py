"""Socket of a running case: what its readers get, and what they cannot do to it or to each other."""

from __future__ import annotations

import asyncio
import os
import socket
import stat
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest
from coded_errors import raises

from procedures.live.errors import FEED_UNREADABLE, NO_FEED
from procedures.live.feed_reader import read_feed
from procedures.live.feed_socket import SOCKET_FILE, FeedSocket
from procedures.live.records import ArmJoints, Began, LiveRecord, RunState

BEGAN = Began(theatre_time_s=0.0, run="R1", epoch_ns=1_700_000_000_000_000_000)
AWAITED_S = 20.0  # host time, for what comes at once


@pytest.fixture
def feed(tmp_path: Path) -> Iterator[FeedSocket]:
    opened = FeedSocket(tmp_path, BEGAN)
    yield opened
    opened.close()


def _joints(number: int) -> ArmJoints:
    return ArmJoints(theatre_time_s=float(number), arm="robot.master", measured_rad=(float(number),) * 6)


async def _next(records: AsyncIterator[LiveRecord]) -> LiveRecord:
    return await asyncio.wait_for(anext(records), AWAITED_S)


def test_a_reader_gets_the_beginning_the_latest_of_every_subject_and_then_what_comes(
    tmp_path: Path, feed: FeedSocket
) -> None:
    state = RunState(theatre_time_s=0.5, run="R1", state="planning")
    feed.offer([_joints(1), state])
    feed.offer([_joints(2)])

    async def read() -> None:
        records = read_feed(tmp_path)
        first = [await _next(records) for _ in range(3)]
        assert first[0] == BEGAN
        assert set(first[1:]) == {_joints(2), state}
        feed.offer([_joints(3)])
        assert await _next(records) == _joints(3)

    asyncio.run(read())


def test_a_reader_reads_to_the_end_of_the_case(tmp_path: Path) -> None:
    feed = FeedSocket(tmp_path, BEGAN)

    async def read() -> list[LiveRecord]:
        records = read_feed(tmp_path)
        first = await _next(records)
        feed.offer([_joints(1)])
        await asyncio.to_thread(feed.close)
        return [first, *[record async for record in records]]

    assert asyncio.run(read()) == [BEGAN, _joints(1)]
    assert not (tmp_path / SOCKET_FILE).exists()


def test_a_reader_that_does_not_read_delays_nobody_and_gets_the_newest(
    tmp_path: Path, feed: FeedSocket
) -> None:
    async def read() -> None:
        slow, quick = read_feed(tmp_path), read_feed(tmp_path)
        assert await _next(slow) == await _next(quick) == BEGAN
        last = 20_000  # far more than sockets buffer
        for number in range(last + 1):
            feed.offer([_joints(number)])
        while await _next(quick) != _joints(last):
            pass
        seen = 1
        while await _next(slow) != _joints(last):
            seen += 1
        assert seen < last

    asyncio.run(read())


def test_only_the_user_of_the_run_can_connect_however_long_the_path_is(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 40) / "R1"
    folder.mkdir(parents=True)
    feed = FeedSocket(folder, BEGAN)
    assert stat.S_IMODE((folder / SOCKET_FILE).stat().st_mode) == 0o600
    assert asyncio.run(_first(folder)) == BEGAN
    feed.close()


async def _first(folder: Path) -> LiveRecord:
    return await _next(read_feed(folder))


def test_a_folder_in_which_nothing_runs_is_told_apart(tmp_path: Path) -> None:
    with raises(NO_FEED, match="no case is running"):
        asyncio.run(_first(tmp_path))
    FeedSocket(tmp_path, BEGAN).close()
    with socket.socket(socket.AF_UNIX) as killed:
        directory = os.open(tmp_path, os.O_RDONLY)
        killed.bind(f"/proc/self/fd/{directory}/{SOCKET_FILE}")
        os.close(directory)
    with raises(NO_FEED, match="no case is running"):
        asyncio.run(_first(tmp_path))
    feed = FeedSocket(tmp_path, BEGAN)  # the run was resumed
    assert asyncio.run(_first(tmp_path)) == BEGAN
    feed.close()


def test_a_feed_of_another_version_is_refused(tmp_path: Path) -> None:
    feed = FeedSocket(tmp_path, BEGAN.model_copy(update={"version": 99}))
    with raises(FEED_UNREADABLE, match="another version"):
        asyncio.run(_first(tmp_path))
    feed.close()
