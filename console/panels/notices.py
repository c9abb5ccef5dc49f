"""Faults, refusals and findings, newest first, with what to do; and the end of the journal."""

from __future__ import annotations

from console.errors import UnreliableRun
from console.feed.view import CaseView, Notice
from console.panels.html import tag, text
from procedures.reporting.case_figures import CaseFigures

SIGNS = {"fault": ("✗ fault", "bad"), "refused": ("⊘ refused", "warn"), "finding": ("! note", "warn")}
JOURNAL_LINES = LOG_LINES = 60


def notices(view: CaseView) -> str:
    """A list."""
    if not view.notices:
        return tag("p", "No faults or refusals.", class_="dim")
    return tag("ul", "".join(_notice(one) for one in reversed(view.notices)), class_="notices")


def _notice(notice: Notice) -> str:
    words, kind = ("✓ settled", "dim") if notice.settled else SIGNS[notice.kind]
    head = tag("strong", f"{words} {text(notice.code)}".rstrip(), class_=kind)
    when = tag("span", f"{notice.theatre_time_s:.1f} s", class_="when")
    advice = (
        tag("div", f"Do: {text(notice.advice)}", class_="advice")
        if notice.advice and not notice.settled
        else ""
    )
    return tag("li", f"{head} {when}<div>{text(notice.what)}</div>{advice}")


def problems(figures: CaseFigures | None) -> str:
    """What in a run folder is truncated, changed or of another version, and what to do."""
    if figures is None or not figures.problems:
        return ""
    first, *more = figures.problems
    others = f" and {len(more)} more" if more else ""
    error = UnreliableRun(f"parts of this run cannot be relied on: {first}{others}")
    return tag("div", text(error), class_="said", role="alert")


def log(lines: tuple[str, ...]) -> str:
    """The last lines, newest first; warnings and errors are marked by their level."""
    shown = "".join(tag("li", text(line), class_=_level(line)) for line in reversed(lines[-LOG_LINES:]))
    return tag("ol", shown, class_="journal") if shown else tag("p", "No log entries yet.", class_="dim")


def _level(line: str) -> str:
    level = line.split(" ", 2)[1:2]
    return {"warning": "warn", "error": "bad", "critical": "bad"}.get(level[0] if level else "", "")


def journal(view: CaseView) -> str:
    """The last lines, newest first."""
    lines = "".join(tag("li", text(line)) for line in reversed(view.journal[-JOURNAL_LINES:]))
    return tag("ol", lines, class_="journal") if lines else tag("p", "No journal entries yet.", class_="dim")
