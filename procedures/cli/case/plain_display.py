"""Lines about a running case, without escape codes: for files, pipes and dumb terminals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext

from procedures.cli.case.case_lines import join_voided, plain_line_of
from procedures.engine.events import Event


def write_lines(write: Callable[[str], None], events: Sequence[Event]) -> None:
    """Write one line for each finished step, voided result and finding."""
    for event in join_voided(events):
        if (line := plain_line_of(event)) is not None:
            write(line)


class PlainDisplay:
    """Display of events as lines, in place of a live one: nothing is drawn over, so nothing is hidden."""

    def __init__(self, write: Callable[[str], None]) -> None:
        """Write each line with `write`."""
        self._write = write
        self._status = ""

    def status(self, text: str) -> None:
        """Write a progress message, once."""
        if text != self._status:
            self._write(text)
        self._status = text

    def tell(self, text: str) -> None:
        """Write a line."""
        self._write(text)

    def show(self, events: Sequence[Event]) -> None:
        """Write a line for each of these events that has one."""
        write_lines(self._write, events)

    def shown(self) -> AbstractContextManager[None]:
        """Do nothing: lines stay where they are."""
        return nullcontext()

    def hidden(self) -> AbstractContextManager[None]:
        """Do nothing: a question is written below the lines."""
        return nullcontext()
