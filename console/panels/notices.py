"""Faults, refusals and findings, newest first: what happened and what to do; and the end of the journal."""

from __future__ import annotations

from console.feed.view import CaseView, Notice
from console.panels.html import tag, text

SIGNS = {"fault": ("✗ fault", "bad"), "refused": ("⊘ refused", "warn"), "finding": ("! note", "warn")}
JOURNAL_LINES = 60


def notices(view: CaseView) -> str:
    """A list."""
    if not view.notices:
        return tag("p", "Nothing has gone wrong.", class_="dim")
    return tag("ul", "".join(_notice(one) for one in reversed(view.notices)), class_="notices")


def _notice(notice: Notice) -> str:
    words, kind = SIGNS[notice.kind]
    head = tag("strong", f"{words} {text(notice.code)}".rstrip(), class_=kind)
    when = tag("span", f"{notice.theatre_time_s:.1f} s", class_="when")
    advice = tag("div", f"Do: {text(notice.advice)}", class_="advice") if notice.advice else ""
    return tag("li", f"{head} {when}<div>{text(notice.what)}</div>{advice}")


def journal(view: CaseView) -> str:
    """The last lines, newest first."""
    lines = "".join(tag("li", text(line)) for line in reversed(view.journal[-JOURNAL_LINES:]))
    return tag("ol", lines, class_="journal") if lines else tag("p", "Nothing is written yet.", class_="dim")
