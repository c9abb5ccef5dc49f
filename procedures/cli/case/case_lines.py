"""Lines of text about a case: its history, one line an event, and its current state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby

from procedures.engine.case_view import FAULT, FINDING, OPENING, CaseView, DeviceRow, Notice
from procedures.engine.events import Advisory, Event, StepState
from procedures.engine.events.stream import LAST_LINES
from procedures.engine.states import HELD
from procedures.runs.observers import SEAT_AWAITED
from ronna_hw.text import format_count

LAST_ERRORS = 2
STARTING = "starting"
INTERRUPTED = ("!", "yellow")
MARKS = {"done": ("✓", "green"), "superseded": ("~", "yellow")}
FAILED = ("✗", "red")
ABOUT = ("step", "what", "topic", "device", "text")  # fields of a journal line; the first it has is shown


@dataclass(frozen=True)
class CaseEntry:
    """One line in the history of a case."""

    mark: str
    style: str
    text: str


def join_voided(events: Iterable[Event]) -> Iterator[Event]:
    """Join results that no longer hold for one and the same reason into one event."""
    for reason, group in groupby(events, _voided_by):
        same = list(group)
        if reason:
            records = ", ".join(str(one.what.record) for one in same if isinstance(one.what, StepState))
            what = same[0].what.model_copy(update={"record": records})
            same = [same[0].model_copy(update={"what": what})]
        yield from same


def _voided_by(event: Event) -> str:
    what = event.what
    return what.summary if isinstance(what, StepState) and what.state == "superseded" else ""


def entry_of(event: Event, *, errors: bool = True) -> CaseEntry | None:
    """Return the history line for a step outcome or finding, or None for other events.

    Without `errors`, which are shown beside it, a failed step is shown with its code only.
    """
    match event.what:
        case StepState(state="begun"):
            return None
        case StepState(step=step, state="superseded", record=record, summary=reason):
            how = f"{_hold(record)}: {reason}" if reason else f"is superseded by a new {step}"
            return CaseEntry(*MARKS["superseded"], f"{record} {how}")
        case StepState(state="failed", summary=summary) as step if not errors:
            return CaseEntry(*FAILED, f"{_name_step(step)}: {_code_of(summary)}")
        case StepState(state="interrupted") as step:
            return CaseEntry(*INTERRUPTED, f"{_name_step(step)}: interrupted")
        case StepState(state=state, summary=summary) as step:
            return CaseEntry(*MARKS.get(state, FAILED), f"{_name_step(step)}: {summary}")
        case Advisory(text=text):
            return CaseEntry("!", "yellow", text)
        case _:
            return None


def _hold(records: str | None) -> str:
    return "no longer hold" if ", " in str(records) else "no longer holds"


def _name_step(step: StepState) -> str:
    """Name a step in words, with its code beside."""
    return f"{step.title} ({step.step})" if step.title else step.step


def plain_line_of(event: Event) -> str | None:
    """Return a plain line for a finished step, voided result or finding, or None for other events."""
    match event.what:
        case StepState(step=step, title=title, state="done", summary=summary):
            return f"done {step} ({title}): {summary}"  # scripts await its code
        case StepState(state="superseded", record=record, summary=reason) if reason:
            return f"note: {record} {_hold(record)}: {reason}"
        case Advisory(text=text):
            return f"note: {text}"
        case _:
            return None


def describe_state(state: str, reason: str) -> str:
    """Describe the state of a case with its reason, except for a held case, whose failed step explains it."""
    return f"{state} ({reason})" if reason and state != HELD else state


def describe_loss(count: int) -> str:
    """Describe how many signals a follower has missed."""
    missed = format_count(count, "pose or other signal", "poses and other signals")
    return f"not in the file of events: {missed}; no fact is missing"


def describe_activity(view: CaseView) -> str:
    """Describe what a case is doing or waiting for; empty before its first step."""
    if view.awaits_order:
        whom = f"waiting for an order of {view.seat.holder}" if view.seat else SEAT_AWAITED
        return f"{whom}; next is {view.upcoming}"
    return f"{view.latest_step}: {view.doing}" if view.doing else view.latest_step


def status_lines(view: CaseView) -> list[tuple[str, str]]:
    """Return the style and text of each line shown below the progress bar."""
    shown = [("", _describe_case(view))]
    if view.devices:
        shown.append(("", "   ".join(map(_describe_device, view.devices.values()))))
    shown += [("dim", _summarize_line(line)) for line in view.journal[-LAST_LINES:]]
    if view.lost_signals:
        shown.append(("dim", describe_loss(view.lost_signals)))
    errors = [item for item in view.notices if item.kind != FINDING and not item.retried]
    return shown + [("red", _describe_error(item)) for item in errors[-LAST_ERRORS:]]


def _describe_case(view: CaseView) -> str:
    if view.question is not None:
        return f"{view.state} (asks: {view.question.subject})"
    return STARTING if view.state == OPENING else describe_state(view.state, view.reason)


def _describe_device(row: DeviceRow) -> str:
    age = "" if row.age_s is None else f" {row.age_s:.1f} s"
    fault = f" [{_code_of(row.seen.fault)}]" if row.seen.fault else ""
    return f"{row.seen.device} {row.seen.state}{age}{fault}"


def _describe_error(notice: Notice) -> str:
    if notice.kind == FAULT:
        return f"{notice.code}: {notice.what} {notice.advice}".rstrip()
    return f"{notice.step} refused: {notice.what}"


def _code_of(error: str) -> str:
    """Return the error code at the start of an error text."""
    return error.partition(": ")[0]


def _summarize_line(line: Mapping[str, object]) -> str:
    about = next((line[name] for name in ABOUT if name in line), "")
    return f"{line.get('sequence')} {line.get('entry')} {about}"
