"""Reader of a running case's records, for programs beside it."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
from collections.abc import AsyncIterator
from pathlib import Path

from procedures.live.errors import FEED_UNREADABLE, NO_FEED
from procedures.live.feed_socket import SOCKET_FILE, socket_address
from procedures.live.records import LARGEST_LINE_BYTES, Began, LiveRecord, read_record


async def read_feed(run: Path) -> AsyncIterator[LiveRecord]:
    """Yield the records of a running case to its end: `Began`, the latest of every subject, then new ones.

    Raises LIV-001 where no case runs in this folder, LIV-002 for a line that is no record of this version.
    """
    reader, writer = await asyncio.open_unix_connection(sock=_connect(run), limit=LARGEST_LINE_BYTES)
    try:
        number = 0
        while line := await _next_line(reader, number := number + 1, run):
            yield _read(line, number, run)
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


def _connect(run: Path) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        folder = os.open(run, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            connection.connect(socket_address(folder))
        finally:
            os.close(folder)
    except OSError as error:
        connection.close()
        is_over = error.errno in (errno.ENOENT, errno.ECONNREFUSED)  # the latter after a kill
        got = f"there is no {SOCKET_FILE} that answers" if is_over and run.is_dir() else error.strerror
        raise NO_FEED(f"no case is running in {run}", got=got) from error
    return connection


async def _next_line(reader: asyncio.StreamReader, number: int, run: Path) -> bytes:
    """Return the next line, or nothing at the end; a line that a kill has cut is no line."""
    try:
        return await reader.readuntil(b"\n")
    except (asyncio.IncompleteReadError, ConnectionResetError):
        return b""
    except asyncio.LimitOverrunError as error:
        raise FEED_UNREADABLE(
            f"line {number} of the live feed of {run.name} is too long", limit=f"{LARGEST_LINE_BYTES} bytes"
        ) from error


def _read(line: bytes, number: int, run: Path) -> LiveRecord:
    try:
        record = read_record(line)
    except ValueError as error:
        raise FEED_UNREADABLE(f"line {number} of the live feed of {run.name} is no record") from error
    if isinstance(record, Began) and record.version != Began.VERSION:
        raise FEED_UNREADABLE(
            f"the live feed of {run.name} is of another version",
            expected=f"version {Began.VERSION}",
            got=f"version {record.version}",
        )
    return record
