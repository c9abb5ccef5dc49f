"""Messages, tables and progress bars for commands.

Messages go to standard error: coloured and wrapped on a terminal, one unwrapped line elsewhere. Tables go to
standard output: framed on a wide enough terminal, tab-separated lines elsewhere. A dumb terminal, or one with
NO_COLOR set, gets no escape codes: neither colours nor a picture that is drawn over.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, TextIO

from ronna_hw.errors import RonnaError
from ronna_hw.text import printable, printable_lines

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bar


DUMB_TERMINALS = ("dumb", "unknown")  # values of TERM


def on_terminal(stream: TextIO) -> bool:
    """Return whether a stream is a terminal."""
    try:
        return stream.isatty()
    except ValueError:  # closed
        return False


def wants_plain_text() -> bool:
    """Return whether the environment asks for text without escape codes: NO_COLOR, or a dumb TERM."""
    return bool(os.environ.get("NO_COLOR")) or os.environ.get("TERM", "").casefold() in DUMB_TERMINALS


def takes_escapes(stream: TextIO) -> bool:
    """Return whether a stream is a terminal on which colours and live displays can be shown."""
    return on_terminal(stream) and not wants_plain_text()


def tell(line: str) -> None:
    """Print a one-line message on standard error, if it is still open."""
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(printable(line) + "\n")
        sys.stderr.flush()


def tell_address(addresses: Mapping[str, str], tell: Callable[[str], None] = tell) -> None:
    """Print a served page's address as a line for scripts and, on a terminal, also as a link."""
    tell(f"CONSOLE {json.dumps(addresses)}")
    if on_terminal(sys.stderr):
        tell(f"open {addresses['url']}")


def say(line: str = "") -> None:
    """Print text to standard output."""
    sys.stdout.write(printable_lines(line) + "\n")
    sys.stdout.flush()


def fail_with(error: RonnaError, advice: str | None = None) -> None:
    """Print an error as `run` does, for commands that continue afterwards.

    `advice` replaces the error's own if the caller knows better what to do.
    """
    line = " ".join(str(error).split())
    if advice is not None:
        line = f"{line.removesuffix(error.advice).rstrip()} {advice}".rstrip()
    if not on_terminal(sys.stderr):
        tell(line)
        return
    from rich.text import Text

    code, _, rest = line.partition(": ") if error.code else ("", "", line)
    console = message_console()
    with console.capture() as rendered:
        console.print(Text.assemble((f"{code} " if code else "", "bold red"), rest))
    with contextlib.suppress(OSError):
        sys.stderr.write(rendered.get())  # a live display keeps this above itself, unlike direct output
        sys.stderr.flush()


def message_console() -> Console:
    """Return the rich console for standard error."""
    from rich.console import Console

    return Console(
        stderr=True,
        soft_wrap=not on_terminal(sys.stderr),
        color_system="auto" if takes_escapes(sys.stderr) else None,
    )


FRAME_WIDTH = 3  # of a table's frame, per column


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table on standard output: framed if it fits the terminal, else tab-separated.

    Cells and headings wrap only between words; a frame that would split a word or a number is not drawn.
    """
    table_rows = [list(columns), *([printable_lines(str(cell)) for cell in row] for row in rows)]
    widths = (
        _column_widths(table_rows, shutil.get_terminal_size().columns) if on_terminal(sys.stdout) else None
    )
    if widths is None:
        for row in table_rows:
            sys.stdout.write("\t".join(row) + "\n")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for column, width in zip(columns, widths, strict=True):
        table.add_column(Text(column), width=width, overflow="fold")
    for row in table_rows[1:]:
        table.add_row(*(Text(cell) for cell in row))
    sys.stdout.write(f"{printable(title)}\n")  # a table's own title would wrap at the table's width
    sys.stdout.flush()
    Console(color_system="auto" if takes_escapes(sys.stdout) else None).print(table)


def _column_widths(rows: Sequence[Sequence[str]], terminal_width: int) -> list[int] | None:
    """Return column widths that fit the terminal without splitting a word, or None if impossible."""
    by_column = list(zip(*rows, strict=True))
    widths = [max((len(word) for cell in cells for word in cell.split()), default=0) for cells in by_column]
    wanted = [max(len(line) for cell in cells for line in cell.split("\n")) for cells in by_column]
    if (spare := terminal_width - 1 - FRAME_WIDTH * len(widths) - sum(widths)) < 0:
        return None
    for _ in range(spare):  # to the column that needs it most
        lacking = [want - width for want, width in zip(wanted, widths, strict=True)]
        if max(lacking, default=0) <= 0:
            break
        widths[lacking.index(max(lacking))] += 1
    return widths


BAR_WIDTH = 24  # beside a description of 45 characters in a line of 80
PROGRESS_DELAY_S = 2.0  # no bar for shorter work
PROGRESS_LINE_S = 60.0  # without a terminal: a log shows that the work goes on, and is not filled
Progress = Callable[[float], None]  # called with the fraction done, 0 to 1


@contextlib.contextmanager
def progress_bar(description: str) -> Iterator[ProgressBar]:
    """Show progress on standard error: a bar after two seconds on a terminal, else a line every minute."""
    bar = ProgressBar(description, shown=takes_escapes(sys.stderr))
    try:
        yield bar
    finally:
        bar.close()


class ProgressBar:
    """Progress bar called with the completed fraction. Bar and timer pause while `hidden`.

    If it is not `shown`, as without a terminal or on a dumb one, a line is printed every minute instead.
    """

    def __init__(self, description: str, *, shown: bool) -> None:
        self._began_s, self._hidden_s = time.monotonic(), 0.0
        self._writing = threading.RLock()  # one thread asks a question, another reports progress
        self._is_hidden = False
        self._bar = self._create_bar() if shown else None
        self._task = None if self._bar is None else self._bar.add_task(description, total=1.0)
        self._started = False
        self._description, self._line_due_s = description, self._began_s + PROGRESS_LINE_S

    def __call__(self, share: float, description: str = "") -> None:
        """Report the completed fraction, 0 to 1, of what was described last."""
        with self._writing:
            if self._bar is None or self._task is None:
                self._tell_line(share, description)
                return
            self._bar.update(self._task, completed=share, description=printable(description) or None)
            if not self._started and not self._is_hidden and self._now_s() > self._began_s + PROGRESS_DELAY_S:
                self._started = True
                self._bar.start()

    def _tell_line(self, share: float, description: str) -> None:
        self._description = description or self._description
        if self._now_s() < self._line_due_s or self._is_hidden:
            return
        self._line_due_s = self._now_s() + PROGRESS_LINE_S
        minutes = (self._now_s() - self._began_s) / 60.0
        tell(f"{self._description}: {share:.0%} after {minutes:.0f} min")

    @contextlib.contextmanager
    def hidden(self) -> Iterator[None]:
        """Hide the bar within the block, for example during a prompt."""
        with self._writing:
            since_s = time.monotonic()
            self.close()
            self._is_hidden = True
            try:
                yield
            finally:
                self._is_hidden = False
                self._hidden_s += time.monotonic() - since_s
                if self._bar is not None and self._started:
                    self._bar.start()

    def close(self) -> None:
        """Remove the progress bar."""
        if self._bar is not None and self._started:
            self._bar.stop()

    def _now_s(self) -> float:
        return time.monotonic() - self._hidden_s

    def _create_bar(self) -> Bar:
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        return Bar(
            TextColumn("{task.description}", markup=False),
            BarColumn(BAR_WIDTH),
            TimeElapsedColumn(),
            console=message_console(),
            transient=True,
            get_time=self._now_s,
        )
