"""A run followed from outside by its file of events: what holds now, then what changes, to its end."""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from procedures.engine.errors import EventsUnreadable
from procedures.engine.events.current_state import CurrentState
from procedures.engine.events.event import Event
from procedures.engine.events.event_file import EVENTS_FILE, LARGEST_BYTES
from procedures.engine.events.happenings import VERSION, JournalLine
from procedures.journal.journal import Entry
from ronna_hw.bounded_input import check_json, values_in
from ronna_hw.command_line.errors import PathProblem

MOST_VALUES_OF_JOURNAL = 1_000_000  # in its lines together: nothing else is nested freely; a case has 13,000
LOOK_AGAIN_S = 0.2  # host time: as often as a person can follow


class FollowedRun:
    """Reads only; any number may follow the same run."""

    def __init__(self, folder: Path, sleep: Callable[[float], None] = time.sleep) -> None:
        """Raises CLI-005 for a folder without events."""
        self._path = folder / EVENTS_FILE
        if not self._path.is_file():
            raise PathProblem(
                f"{folder} has no {EVENTS_FILE}", expected="the folder of a run that has started"
            )
        self._sleep = sleep
        self._offset = self._lines = self._values = 0
        self.closed = False  # whether the run came to its own end

    @property
    def over(self) -> bool:
        """Whether the run's own program has let go of the file, however it ended."""
        with self._path.open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return False
        return True

    def batches(self, *, whole: bool = False) -> Iterator[Sequence[Event]]:
        """First what holds at present, or the `whole` course so far, then what happens. Raises PRO-018."""
        over = self.over
        course = self._read()
        if whole:
            yield _in_order(course)
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
        """What was written since; a line that is not complete yet waits."""
        with self._path.open("rb") as file:
            if os.fstat(file.fileno()).st_size > LARGEST_BYTES:
                raise EventsUnreadable(
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
            raise EventsUnreadable(f"line {self._lines} of {self._path} is not an event") from error
        if event.version != VERSION:
            raise EventsUnreadable(
                f"line {self._lines} of {self._path} was written by another version",
                expected=f"version {VERSION}",
                got=f"version {event.version}",
            )
        if isinstance(event.what, JournalLine):
            self.closed = event.what.line.get("entry") == Entry.CLOSED
            self._values += values_in(line)
            if self._values > MOST_VALUES_OF_JOURNAL:
                raise EventsUnreadable(
                    f"too many values in the lines of a journal in {self._path}",
                    expected=f"at most {MOST_VALUES_OF_JOURNAL}",
                )
        return event


def _in_order(course: Sequence[Event]) -> list[Event]:
    """As it happened: signals are written late, and numbers restart each time a run is resumed."""
    program, latest, placed = 0, 0, list[tuple[int, int, Event]]()
    for event in course:
        if not event.what.signal:  # facts are written in their order
            program += event.number < latest
            latest = event.number
        placed.append((program, event.number, event))
    return [event for _, _, event in sorted(placed, key=lambda one: one[:2])]
