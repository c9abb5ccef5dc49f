"""Live terminal display of a case: finished steps scroll past above the current state.

A module of its own, because it imports rich.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from procedures.cli.case import case_lines
from procedures.engine.case_view import CaseView, fold
from procedures.engine.events import Event
from ronna_hw.text import printable


class LiveDisplay:
    """Live display of events: visible within `shown`, cleared within `hidden` for other output."""

    def __init__(self, console: Console, *, errors: bool) -> None:
        """Show errors only if `errors` is set; the operator of a case gets them elsewhere, with advice."""
        self.view = CaseView()
        self._errors = errors
        self._console = console
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TimeElapsedColumn(),
        )
        self._status = case_lines.STARTING
        self._task = self._bar.add_task(self._status, total=1.0)
        self._live = self._picture()

    def _picture(self) -> Live:
        """Create a new, unstarted live area. Reusing an old one would hide later output."""
        return Live(self, console=self._console, transient=True)

    def __rich__(self) -> Group:
        lines = [
            Text(f"  {printable(text)}", style, no_wrap=True, overflow="ellipsis")
            for style, text in case_lines.status_lines(self.view)
        ]
        return Group(self._bar, *lines)

    def status(self, text: str) -> None:
        """Show a progress message until a step begins."""
        self._status = printable(text)
        self._bar.update(self._task, description=self._status)

    def tell(self, text: str) -> None:
        """Print a line without wrapping or markup, so that it can be copied."""
        self._console.print(printable(text), soft_wrap=True, markup=False, highlight=False)

    def show(self, events: Sequence[Event]) -> None:
        """Update the display with these events."""
        for event in events:
            self.view = fold(self.view, event)
        for event in case_lines.join_voided(events):
            if (entry := case_lines.entry_of(event, errors=self._errors)) is not None:
                self._console.print(Text.assemble((entry.mark, entry.style), f" {printable(entry.text)}"))
        self._bar.update(
            self._task,
            completed=0.0 if self.view.awaits_order else self.view.share,
            description=printable(case_lines.describe_activity(self.view)) or self._status,
        )

    @contextlib.contextmanager
    def shown(self) -> Iterator[None]:
        """Show the display while the block runs."""
        self._live.start()
        try:
            yield
        finally:
            self._live.stop()

    @contextlib.contextmanager
    def hidden(self) -> Iterator[None]:
        """Hide the display, if shown, while the block runs."""
        if not self._live.is_started:
            yield
            return
        self._live.stop()
        try:
            yield
        except KeyboardInterrupt:  # the command ends: a picture shown again would stay below its last lines
            raise
        except BaseException:  # also an exit: whatever goes on is shown
            self._show_again()
            raise
        self._show_again()

    def _show_again(self) -> None:
        self._live = self._picture()
        self._live.start()
