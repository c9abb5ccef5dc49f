"""Socket of a running case, `RUN/live.sock`, on which local programs read its records.

A reader gets `Began`, the latest record of every subject, then new ones. Each reader has one slot per
subject, which newer records replace. One that does not read loses old records, and nobody waits for it.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import threading
import time
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from procedures.live.records import Began, LiveRecord, as_line
from ronna_hw.logs import logger

SOCKET_FILE = "live.sock"
MOST_READERS = 16
CLOSE_LIMIT_S = 1.0  # host time for what readers have not yet received
Subject = tuple[str, str]


def socket_address(folder: int) -> str:
    """Return the address of the socket in an open folder: short, however long the path of the folder is."""
    return f"/proc/self/fd/{folder}/{SOCKET_FILE}"


class _Line:
    """Record and its line, encoded once for all readers and only if there is one."""

    def __init__(self, record: LiveRecord) -> None:
        self._record = record
        self.subject: Subject = record.kind, record.about

    @cached_property
    def content(self) -> bytes:
        return as_line(self._record)


class _Reader:
    """Connected reader with the records that wait for it."""

    def __init__(self, connection: socket.socket, waiting: dict[Subject, _Line]) -> None:
        self.connection = connection
        self.waiting = waiting
        self._sending = memoryview(b"")

    @property
    def is_served(self) -> bool:
        return not (self.waiting or self._sending)

    def send(self, lock: threading.Lock) -> None:
        """Send as much as the reader takes. Raises OSError, BlockingIOError when it takes no more."""
        while True:
            if not self._sending:
                with lock:
                    lines, self.waiting = self.waiting, {}
                if not lines:
                    return
                self._sending = memoryview(b"".join(line.content for line in lines.values()))
            self._sending = self._sending[self.connection.send(self._sending) :]


class FeedSocket:
    """Server of one run's records, in a thread of its own."""

    def __init__(self, folder: Path, began: Began) -> None:
        """Open the socket for this user only. Raises OSError."""
        self._folder = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        self._began = began
        self._latest: dict[Subject, _Line] = {}
        self._readers: list[_Reader] = []
        self._lock = threading.Lock()
        self._ending = False
        self._server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            address = socket_address(self._folder)
            with contextlib.suppress(FileNotFoundError):
                os.unlink(address)  # of a program that was killed
            self._server.bind(address)
            os.chmod(address, 0o600)  # before anybody can connect
            self._server.listen(MOST_READERS)
        except OSError:
            self._server.close()
            os.close(self._folder)
            raise
        self._server.setblocking(False)
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._serve, name="live feed readers", daemon=True)
        self._thread.start()

    @property
    def has_readers(self) -> bool:
        return bool(self._readers)

    def offer(self, records: Iterable[LiveRecord]) -> None:
        """Pass records on to all readers. Never blocks; may be called from any thread."""
        lines = {line.subject: line for line in map(_Line, records)}
        with self._lock:
            self._latest.update(lines)
            for reader in self._readers:
                reader.waiting.update(lines)
        if lines and self._readers:
            os.eventfd_write(self._wake, 1)

    def close(self) -> None:
        """Deliver what readers take in time, and remove the socket. Never raises."""
        self._ending = True
        os.eventfd_write(self._wake, 1)
        self._thread.join()
        with contextlib.suppress(OSError):
            os.unlink(socket_address(self._folder))
        for number in (self._folder, self._wake):
            os.close(number)

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector, self._server:
            selector.register(self._server, selectors.EVENT_READ)
            selector.register(self._wake, selectors.EVENT_READ)
            while not self._ending:
                for key, _ in selector.select():
                    if key.fileobj is self._server:
                        self._admit(selector)
                    elif isinstance(key.data, _Reader):
                        self._serve_reader(selector, key.data)
                    else:
                        with contextlib.suppress(BlockingIOError):
                            os.eventfd_read(self._wake)
                for reader in [one for one in self._readers if one.waiting]:
                    self._serve_reader(selector, reader)
            self._deliver_last(selector)

    def _deliver_last(self, selector: selectors.BaseSelector) -> None:
        """Send to all readers what waits, within one limit for all of them, and end their connections."""
        deadline_s = time.monotonic() + CLOSE_LIMIT_S
        for reader in list(self._readers):
            self._serve_reader(selector, reader)
        while (left_s := deadline_s - time.monotonic()) > 0.0 and not all(
            reader.is_served for reader in self._readers
        ):
            for key, _ in selector.select(left_s):
                if isinstance(key.data, _Reader) and not key.data.is_served:
                    self._serve_reader(selector, key.data)
        for reader in list(self._readers):
            self._dismiss(selector, reader)

    def _admit(self, selector: selectors.BaseSelector) -> None:
        try:
            connection, _ = self._server.accept()
        except OSError:  # it has gone again, or there are too many open files
            return
        if len(self._readers) == MOST_READERS:
            logger(part="live feed").warning("too many readers of the live feed", limit=MOST_READERS)
            connection.close()
            return
        connection.setblocking(False)
        began = _Line(self._began)
        with self._lock:
            reader = _Reader(connection, {began.subject: began, **self._latest})
            self._readers.append(reader)
        selector.register(connection, selectors.EVENT_READ, reader)

    def _serve_reader(self, selector: selectors.BaseSelector, reader: _Reader) -> None:
        """Send to a reader, and note its end. It has nothing to say: whatever it sends is dropped."""
        try:
            with contextlib.suppress(BlockingIOError):
                if not reader.connection.recv(1 << 16):
                    raise ConnectionResetError
            with contextlib.suppress(BlockingIOError):
                reader.send(self._lock)
        except OSError:
            self._dismiss(selector, reader)
            return
        wanted = selectors.EVENT_READ | (0 if reader.is_served else selectors.EVENT_WRITE)
        selector.modify(reader.connection, wanted, reader)

    def _dismiss(self, selector: selectors.BaseSelector, reader: _Reader) -> None:
        with self._lock:
            self._readers.remove(reader)
        selector.unregister(reader.connection)
        reader.connection.close()
