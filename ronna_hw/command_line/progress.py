"""A progress bar on standard error for longer work."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from ronna_hw.command_line.messages import message_console, on_terminal

PROGRESS_DELAY_S = 2.0  # no bar for shorter work

Progress = Callable[[float], None]  # called with the share done, 0 to 1


@contextlib.contextmanager
def progress_bar(description: str) -> Iterator[Progress]:
    """A progress bar on standard error after two seconds of work; none off a terminal."""
    if not on_terminal(sys.stderr):
        yield lambda share: None
        return
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    bar = Bar(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=message_console(),
        transient=True,
    )
    task = bar.add_task(description, total=1.0)
    began_s = time.monotonic()
    shown = False

    def advance(share: float) -> None:
        nonlocal shown
        bar.update(task, completed=share)
        if not shown and time.monotonic() - began_s > PROGRESS_DELAY_S:
            shown = True
            bar.start()

    try:
        yield advance
    finally:
        if shown:
            bar.stop()
