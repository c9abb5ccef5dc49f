"""Event stream on disk (`RUN/events.jsonl`), one event per line, for followers in other processes.

Evidence is the journal's business; this file is a convenience and never stops anything. Every fact is in it,
signals at a bounded rate and size, and how many of them are missing. Its writer holds a lock on it, so that a
follower can distinguish a quiet run from a killed one.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from pydantic import ValidationError

from procedures.engine.errors import EVENTS_UNREADABLE
from procedures.engine.events.event_types import VERSION, Event, JournalLine, SignalsLost
from procedures.engine.events.stream import CurrentState, EventStream
from procedures.journal.journal import Entry
from ronna_hw.bounded_input import check_json, count_values
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from ronna_hw.logs import logger

SIGNAL_PERIOD_S = 0.5  # host time between two signals about the same: what a person can follow
LOST_PERIOD_S = 60.0  # host time between two lines with the number of missing signals
SIGNALS_BYTES = 8 << 20  # of signals of one program; some ten hours of an arm, a tracker and a stereo head
CHANGED_ACTION = (
    "The file was changed, or its disk is damaged: ronna-procedure verify RUN names what differs."
)
LARGEST_BYTES = 100_000_000  # of the file: a dozen programs with all their signals
LOCK_TRIES, LOCK_AGAIN_S = 20, 0.01  # host time between two tries
WAITING_LINES = 10_000  # facts that wait for a full disk; a case has some thousands
_log = logger(part="events")
MOST_VALUES_OF_JOURNAL = 1_000_000  # in its lines together: nothing else is nested freely; a case has 13,000
LOOK_AGAIN_S = 0.2  # host time: as often as a person can follow


class EventFile:
    """Background writer of a run's event file."""

    def __init__(self, folder: Path, events: EventStream, *, signals_bytes: int = SIGNALS_BYTES) -> None:
        """Start the writer thread. Write failures are logged, never raised, and do not affect the case."""
        self._path = folder / EVENTS_FILE
        self._reader = events.subscribe()
        self._signals_left = signals_bytes
        self._written_s: dict[str, float] = {}  # monotonic, of signals by subject
        self._deferred: dict[str, Event] = {}  # signals that came too soon
        self._lost = self._lost_reported = 0  # signals that are not in the file
        self._lost_reported_s = time.monotonic()
        self._last: Event | None = None
        self._waiting: list[bytes] = []
        self._failure_logged = False
        self._file = self._open()
        self._thread = threading.Thread(target=self._write_all, name="event file", daemon=True)
        self._thread.start()

    def join(self, timeout_s: float = 2.0) -> None:
        """Wait until everything up to the end of the stream is written."""
        self._thread.join(timeout_s)

    def _open(self) -> int | None:
        try:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
        except OSError as error:
            self._log_failure(error)
            return None
        try:
            _lock(file)
            begin = max(0, os.fstat(file).st_size - LARGEST_BYTES)
            tail = os.pread(file, LARGEST_BYTES, begin)  # of a killed program the last line may be torn
            os.ftruncate(file, begin + tail.rfind(b"\n") + 1)
        except OSError as error:
            os.close(file)
            self._log_failure(error)
            return None
        return file

    def _write_all(self) -> None:
        ended = False
        while not ended:
            self._reader.wait(self._time_to_due_s(), facts_only=bool(self._deferred))
            batch = self._reader.read(0.0)
            ended = batch.ended
            self._lost += batch.lost
            for event in batch.events:
                self._last = event
                if event.what.signal:
                    self._lost += event.subject in self._deferred
                    self._deferred[event.subject] = event
                else:
                    self._waiting.append(_line(event))
            self._release_signals(release_all=ended)
            self._tell_lost(at_once=ended)
            self._write()
        if self._file is not None:
            os.close(self._file)

    def _time_to_due_s(self) -> float | None:
        if not self._deferred:
            return None
        now_s = time.monotonic()
        return max(0.0, min(self._due_s(subject) for subject in self._deferred) - now_s)

    def _due_s(self, subject: str) -> float:
        return self._written_s.get(subject, -SIGNAL_PERIOD_S) + SIGNAL_PERIOD_S

    def _release_signals(self, *, release_all: bool) -> None:
        now_s = time.monotonic()
        for subject in [one for one in self._deferred if release_all or self._due_s(one) <= now_s]:
            line = _line(self._deferred.pop(subject))
            self._written_s[subject] = now_s
            if self._signals_left >= len(line):
                self._signals_left -= len(line)
                self._waiting.append(line)
            else:
                self._lost += 1

    def _tell_lost(self, *, at_once: bool) -> None:
        """Report lost signals under the number and time of the last event, without using a new number."""
        now_s = time.monotonic()
        due = at_once or now_s - self._lost_reported_s >= LOST_PERIOD_S
        if due and self._lost > self._lost_reported and (last := self._last) is not None:
            self._lost_reported, self._lost_reported_s = self._lost, now_s
            self._waiting.append(_line(last.model_copy(update={"what": SignalsLost(count=self._lost)})))

    def _write(self) -> None:
        """Write the pending lines completely or not at all; keep unwritten ones for the next call."""
        if self._file is None or not self._waiting:
            self._waiting.clear()
            return
        content = b"".join(self._waiting)
        try:
            size = os.fstat(self._file).st_size
            try:
                written = os.write(self._file, content)
            except OSError as error:
                written, problem = 0, error
            else:
                problem = OSError("the disk is full")
            if written == len(content):
                self._waiting.clear()
                return
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, size)
        except OSError as error:
            problem = error
        self._log_failure(problem)
        del self._waiting[:-WAITING_LINES]

    def _log_failure(self, problem: OSError) -> None:
        if not self._failure_logged:
            self._failure_logged = True
            _log.warning("events cannot be written", cause=problem)


def _lock(file: int) -> None:
    """Acquire the writer's lock, retrying briefly because followers hold it while checking for a writer."""
    for _ in range(LOCK_TRIES):
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(LOCK_AGAIN_S)
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _line(event: Event) -> bytes:
    return event.model_dump_json().encode() + b"\n"


class FollowedRun:
    """Read-only follower of a run's event file. Any number of programs can follow the same run."""

    def __init__(self, folder: Path, sleep: Callable[[float], None] = time.sleep) -> None:
        """Open a run's event file. Raises CLI-005 if the folder has none."""
        self._path = folder / EVENTS_FILE
        if not self._path.is_file():
            raise PATH_PROBLEM(
                f"{folder} has no {EVENTS_FILE}", expected="the folder of a run that has started"
            )
        self._sleep = sleep
        self._offset = self._lines = self._values = 0
        self.closed = False  # whether the run came to its own end

    @property
    def over(self) -> bool:
        """Whether the program that ran the case has released the file, for whatever reason."""
        with self._path.open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
        return True

    def batches(self, *, whole: bool = False) -> Iterator[Sequence[Event]]:
        """Yield the current state (the full history if `whole`), then new events. Raises PRO-018."""
        over = self.over
        course = self._read()
        if whole:
            yield _sort_events(course)
        else:
            current = CurrentState()
            for event in course:
                current.take_in(event)
            yield current.events
        while not over:
            self._sleep(LOOK_AGAIN_S)
            over = self.over  # before the last look
            if events := self._read():
                yield events

    def _read(self) -> list[Event]:
        """Return events from whole lines written since the last call."""
        with self._path.open("rb") as file:
            if os.fstat(file.fileno()).st_size > LARGEST_BYTES:
                raise EVENTS_UNREADABLE(
                    f"{self._path} is too large", expected=f"at most {LARGEST_BYTES} bytes"
                )
            file.seek(self._offset)
            content = file.read(LARGEST_BYTES)
        content = content[: content.rfind(b"\n") + 1]
        self._offset += len(content)
        return [self._event(line) for line in content.splitlines()]

    def _event(self, line: bytes) -> Event:
        self._lines += 1
        try:
            event = Event.model_validate_json(check_json(line))
        except ValueError as error:  # also a line out of bounds
            is_json = not isinstance(error, ValidationError) or error.errors()[0]["type"] != "json_invalid"
            raise EVENTS_UNREADABLE(
                f"line {self._lines} of {self._path} is not {'an event' if is_json else 'JSON'}",
                action=None if is_json else CHANGED_ACTION,
            ) from error
        if event.version != VERSION:
            raise EVENTS_UNREADABLE(
                f"line {self._lines} of {self._path} was written by another version",
                expected=f"version {VERSION}",
                got=f"version {event.version}",
            )
        if isinstance(event.what, JournalLine):
            self.closed = event.what.line.get("entry") == Entry.CLOSED
            self._values += count_values(line)
            if self._values > MOST_VALUES_OF_JOURNAL:
                raise EVENTS_UNREADABLE(
                    f"too many values in the lines of a journal in {self._path}",
                    expected=f"at most {MOST_VALUES_OF_JOURNAL}",
                )
        return event


def _sort_events(course: Sequence[Event]) -> list[Event]:
    """Sort events chronologically: signals are written late, and numbers restart on resume."""
    program, latest, numbered = 0, 0, list[tuple[int, int, Event]]()
    for event in course:
        if not event.what.signal:  # facts are written in their order
            program += event.number < latest
            latest = event.number
        numbered.append((program, event.number, event))
    return [event for _, _, event in sorted(numbered, key=lambda one: one[:2])]
