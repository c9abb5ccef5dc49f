"""`ronna-procedure watch`: follows a run from another terminal by its events; changes nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from procedures.cli.case.case_view import entry_of, in_words, lost_in_words
from procedures.engine.events import CaseState, Event, Questioned, Refusal, SignalsLost
from procedures.engine.events.followed_run import FollowedRun
from ronna_hw.command_line.terminal import message_console, on_terminal, tell
from ronna_hw.evidence.inspection import inspected
from ronna_hw.text import printable


def watch(run: Path, *, as_json: bool) -> None:
    """Show what holds, then what happens, until the run has ended. Raises CLI-005, PRO-018.

    Of a run that is over, first what is not as it left it.
    """
    followed = FollowedRun(run)
    if followed.over:
        for change in inspected(run).changes:
            tell(f"NOT AS THE RUN LEFT IT: {change}")
    if as_json:
        _write(followed, lambda event: event.model_dump_json(ensure_ascii=True))
    elif on_terminal(sys.stderr):
        from procedures.cli.case.live_display import LiveDisplay

        display = LiveDisplay(message_console(), errors=True)
        with display.shown():
            for events in followed.batches():
                display.show(events)
        for _style, line in display.view.lines():
            tell(line)
    else:
        _write(followed, line_of)
    if not followed.closed:
        tell("the run was ended without being closed")


def _write(followed: FollowedRun, line_of: Callable[[Event], str | None]) -> None:
    for events in followed.batches():
        for event in events:
            if (line := line_of(event)) is not None:
                sys.stdout.write(line + "\n")
        sys.stdout.flush()


def line_of(event: Event) -> str | None:
    """What a person reads of an event; None for what only changes the picture."""
    line = _line(event)
    return line and printable(line)


def _line(event: Event) -> str | None:
    if (entry := entry_of(event)) is not None:
        return f"{entry.mark} {entry.text}"
    match event.what:
        case CaseState() as case:
            return in_words(case)
        case SignalsLost() as lost:
            return lost_in_words(lost)
        case Questioned(subject=subject, value=value):
            return f"? {subject}: {value}"
        case Refusal(step=step, unmet=unmet):
            return f"✗ {step} refused: {'; '.join(unmet)}"
        case _:
            return None
