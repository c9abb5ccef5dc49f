"""A progress bar on standard error for longer work."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from ronna_hw.command_line.messages import message_console, on_terminal

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

PROGRESS_DELAY_S = 2.0  # no bar for shorter work

Progress = Callable[[float], None]  # called with the fraction done, 0 to 1


class ProgressBar:
    """Called with the fraction done. Bar and timer are paused while `hidden`."""

    def __init__(self, description: str, *, shown: bool) -> None:
        """Never shown if not `shown`, when nobody is watching."""
        self._began_s, self._hidden_s = time.monotonic(), 0.0
        self._writing = threading.RLock()  # one thread asks a question, another reports progress
        self._resting = False
        self._bar = self._made() if shown else None
        self._task = None if self._bar is None else self._bar.add_task(description, total=1.0)
        self._started = False

    def __call__(self, share: float) -> None:
        """The fraction done, 0 to 1."""
        if self._bar is None or self._task is None:
            return
        with self._writing:
            self._bar.update(self._task, completed=share)
            if not self._started and not self._resting and self._now_s() > self._began_s + PROGRESS_DELAY_S:
                self._started = True
                self._bar.start()

    @contextlib.contextmanager
    def hidden(self) -> Iterator[None]:
        """Hidden during the block, in which the user is prompted."""
        with self._writing:
            since_s = time.monotonic()
            self.close()
            self._resting = True
            try:
                yield
            finally:
                self._resting = False
                self._hidden_s += time.monotonic() - since_s
                if self._bar is not None and self._started:
                    self._bar.start()

    def close(self) -> None:
        """Remove it."""
        if self._bar is not None and self._started:
            self._bar.stop()

    def _now_s(self) -> float:
        return time.monotonic() - self._hidden_s

    def _made(self) -> Bar:
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        return Bar(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TimeElapsedColumn(),
            console=message_console(),
            transient=True,
            get_time=self._now_s,
        )


@contextlib.contextmanager
def progress_bar(description: str) -> Iterator[ProgressBar]:
    """A progress bar on standard error after two seconds of work; none off a terminal."""
    bar = ProgressBar(description, shown=on_terminal(sys.stderr))
    try:
        yield bar
    finally:
        bar.close()
