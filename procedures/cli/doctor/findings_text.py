"""The doctor's findings as text: problems first, each with what to do and one command to copy."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Sequence
from textwrap import wrap

from ronna_hw.command_line.terminal import on_terminal
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.text import format_count

INDENT = "   "


def findings_text(
    problems: Sequence[Diagnostic], notes: Sequence[Diagnostic], replies: Sequence[Diagnostic]
) -> Iterator[str]:
    """Yield lines: a numbered list of problems, then notes, then what was asked for."""
    if not problems:
        yield "No problem found."
    else:
        yield f"{format_count(len(problems), 'problem')}:"
        for number, one in enumerate(problems, start=1):
            yield from _lines(f"{number}. ", one)
    if notes:
        yield ""
        yield "Worth knowing:"
        for one in notes:
            yield from _lines("-  ", one)
    if replies:
        yield ""
        for one in replies:
            yield from _wrapped(f"ok {one.subject}: {one.seen}", "")
    yield ""


def _lines(bullet: str, one: Diagnostic) -> Iterator[str]:
    yield from _wrapped(f"{one.subject}: {one.seen}", bullet)
    if one.advice:
        yield from _wrapped(one.advice, INDENT)
    if one.command:
        yield f"{INDENT}{one.command}"  # on one line, whatever the width: it is copied


def _wrapped(text: str, first: str) -> Iterator[str]:
    """Wrap at the terminal's width without splitting words; elsewhere yield one line."""
    text = " ".join(text.split())
    if not on_terminal(sys.stdout):
        yield first + text
        return
    width = max(shutil.get_terminal_size().columns - 1, 2 * len(INDENT))
    yield from wrap(
        text,
        width,
        initial_indent=first,
        subsequent_indent=INDENT,
        break_long_words=False,
        break_on_hyphens=False,
    )
