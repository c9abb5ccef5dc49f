"""Log of a run in MCAP, with the profile of ROS 2: `RUN/flight.mcap`, of a resumed run also `flight-2.mcap`.

A thread of its own encodes and writes. Before a second has passed it completes a chunk and flushes it: a
program killed at any moment loses no more. At the end the file gets its index, statistics and sums. If the
disk is full or stuck, the log ends, and nothing else notices.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path

from procedures.live.log_entries import JointCycles, LogEntry
from procedures.live.log_writer import LogWriter
from procedures.live.records import Began, CameraPicture
from ronna_hw.logs import logger

FIRST_FILE, LATER_FILE = "flight.mcap", "flight-{number}.mcap"
FLUSH_PERIOD_S = 0.75  # host time; lost if the program is killed, with what the feed has not looked at
CLOSE_LIMIT_S = 10.0  # host time for what is still queued
MOST_WAITING_BYTES = 64_000_000  # of entries: minutes of a case
ENTRY_BYTES = 600  # of an entry without arrays or pictures, in memory


def log_files(run: Path) -> list[Path]:
    """Return the logs of a run, one for each program that had it, the first one first."""
    later = sorted(run.glob(LATER_FILE.format(number="*")), key=lambda path: (len(path.name), path.name))
    return [path for path in (run / FIRST_FILE, *later) if path.is_file()]


def next_log_file(run: Path) -> Path:
    """Return the path of the log of the next program that has the run."""
    count = len(log_files(run))
    return run / (LATER_FILE.format(number=count + 1) if count else FIRST_FILE)


class FlightLog:
    """Log of one program of a run."""

    def __init__(
        self,
        path: Path,
        began: Began,
        without_names: Callable[[str], str],
        *,
        flush_period_s: float = FLUSH_PERIOD_S,
        most_waiting_bytes: int = MOST_WAITING_BYTES,
    ) -> None:
        """Start the log. A failure to write is logged, never raised."""
        self._path = path
        self._began = began
        self._without_names = without_names
        self._flush_period_s = flush_period_s
        self._most_waiting_bytes = most_waiting_bytes
        self._queue: deque[tuple[LogEntry, int, int]] = deque()  # with host UTC and size
        self._taken_bytes = self._done_bytes = 0  # each written by one thread
        self._skipped = 0  # entries that have no form as messages
        self._ending = threading.Event()
        self.is_open = True
        self.flushed = 0  # messages that survive this program
        self._thread = threading.Thread(target=self._run, name="flight log", daemon=True)
        self._thread.start()

    def take(self, entries: Iterable[LogEntry]) -> None:
        """Queue entries, from one thread. Never blocks, never raises."""
        now_ns = time.time_ns()
        for entry in entries if self.is_open else ():
            size = _size_of(entry)
            self._taken_bytes += size
            self._queue.append((entry, now_ns, size))
        if self._taken_bytes - self._done_bytes > self._most_waiting_bytes:
            self._end("the disk does not keep up")

    def close(self) -> None:
        """Write what is queued, then index and sums. Bounded in time; never raises."""
        self._ending.set()
        self._thread.join(CLOSE_LIMIT_S)

    def _end(self, reason: object) -> None:
        if self.is_open:
            self.is_open = False
            logger(part="flight log").warning("the log of the run ends here", cause=reason)
        self._queue.clear()

    def _run(self) -> None:
        try:
            with self._path.open("xb") as file:
                writer = LogWriter(file, self._began, self._without_names)
                while self.is_open and not self._ending.wait(self._flush_period_s):
                    self._write_waiting(writer)
                self._write_waiting(writer)
                if self.is_open:
                    writer.finish()
        except Exception as error:  # the disk, mostly; whatever it is, nobody waits for a log that has ended
            self._end(error)

    def _next(self) -> tuple[LogEntry, int, int] | None:
        with contextlib.suppress(IndexError):  # nothing waits any more
            return self._queue.popleft()
        return None

    def _write_waiting(self, writer: LogWriter) -> None:
        while (next_one := self._next()) is not None:
            entry, host_ns, size = next_one
            try:
                writer.write(entry, host_ns)
            except OSError:
                raise
            except Exception as error:  # an entry of unknown form: the next one counts
                self._skipped += 1
                logger(part="flight log").warning(
                    "the log lacks an entry", cause=error, kind=type(entry).__name__, lacking=self._skipped
                )
            self._done_bytes += size
        writer.flush()
        self.flushed = writer.written


def _size_of(entry: LogEntry) -> int:
    if isinstance(entry, JointCycles):
        return ENTRY_BYTES + 3 * entry.measured_rad.nbytes
    return ENTRY_BYTES + (len(entry.jpeg) if isinstance(entry, CameraPicture) else 0)
