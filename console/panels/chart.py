"""The course of the case: done, now, next, and why the next step cannot start."""

from __future__ import annotations

from itertools import groupby

from console.feed.view import CaseView, StepRow
from console.panels.html import tag, text

MARKS = {  # a symbol per state, so that nothing is conveyed by colour alone
    "done": ("✓", "done", "ok"),
    "begun": ("▶", "now", "now"),
    "failed": ("✗", "failed", "bad"),
    "interrupted": ("■", "interrupted", "bad"),
    "superseded": ("~", "superseded", "warn"),
    "next": ("→", "next", "next"),
    "": ("·", "pending", "dim"),
}


def chart(view: CaseView) -> str:
    """The steps by phase; a finished phase is collapsed while another is not finished."""
    finished = all(row.state == "done" for row in view.steps)
    latest = next((row for row in reversed(view.steps) if row.state == "done"), None)
    phases = []
    for phase, rows in groupby(view.steps, key=lambda row: row.phase):
        steps = list(rows)
        done = all(row.state == "done" for row in steps)
        words = f"{phase.capitalize()}: {len(steps)} steps done" if done else phase.capitalize()
        body = tag("summary", text(words))
        body += tag("ol", "".join(_step(view, row, with_summary=finished or row is latest) for row in steps))
        phases.append(f"<details{'' if done and not finished else ' open'}>{body}</details>")
    return _state(view) + ("".join(phases) or tag("p", "Opening the theatre.", class_="dim"))


def chart_key(view: CaseView) -> object:
    """Changes when the chart does."""
    return (
        view.steps,
        view.running,
        view.question is None,
        view.waiting,
        view.state,
        view.reason,
        round(view.share, 2),
        view.doing,
    )


def _state(view: CaseView) -> str:
    state = tag("strong", text(view.state.replace(".", " · ").replace("_", " ")))
    reason = tag("div", text(view.reason), class_="warn") if view.reason else ""
    unmet = view.waiting.unmet if view.waiting else ()
    refused = "".join(tag("li", text(one)) for one in unmet)
    why = (
        tag("div", f"{text(view.upcoming)} cannot start:" + tag("ul", refused), class_="bad") if unmet else ""
    )
    waits = ""
    if view.waiting is not None and not unmet and view.upcoming and view.question is None:
        waits = tag("div", f"waiting for the operator; next: {text(view.upcoming)}", class_="next")
    return tag("div", state + reason + waits + why, class_="state", role="status")


def _step(view: CaseView, row: StepRow, *, with_summary: bool) -> str:
    is_next = row.state not in ("begun", "done") and row.step == view.upcoming and not view.running
    sign, word, kind = MARKS["next" if is_next and not row.state else row.state]
    moves = tag("span", "moves", class_="moves") if row.moves else ""
    shown = tag("span", sign, class_="mark", aria_hidden="true") + tag(
        "span", f"{text(row.title)} {_place(row)}{moves}", class_="title"
    )
    below = row.summary if with_summary or row.state != "done" else ""
    if row.state == "begun":
        below = f"{view.share:.0%} {view.doing}".strip() if view.share or view.doing else ""
        shown += tag("progress", "", max="1", value=f"{view.share:.3f}", aria_label="progress")
    detail = tag("div", text(below), class_="summary") if below else ""
    return tag("li", shown + tag("span", word, class_="word") + detail, class_=kind, data_step=row.step)


def _place(row: StepRow) -> str:
    _, _, place = row.step.partition(":")
    return tag("b", text(place)) + " " if place else ""
