"""Steps, motions and pauses of a run as spans of theatre time, from its journal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from procedures.journal.journal import Entry, Line, theatre_time_s

BETWEEN_STEPS = "between steps"
STEP_ENDS = {Entry.RESULT: "done", Entry.FAILED: "failed", Entry.INTERRUPTED: "interrupted"}


@dataclass(frozen=True)
class Span:
    """Something that took theatre time; `row` is the step it belongs to."""

    kind: Literal["step", "motion", "rest"]
    name: str
    row: str
    begin_s: float
    end_s: float
    ended: str  # done, failed, interrupted, an error code, or `not ended`
    host_time: str  # when it began


def timeline(journal: Sequence[Line]) -> tuple[Span, ...]:
    """The spans in order of their beginning; one that never ended lasts until its program's last line."""
    spans: list[Span] = []
    open_now: dict[str, int] = {}  # open spans by key: index in `spans`
    row, last_s = BETWEEN_STEPS, 0.0
    for line in journal:
        entry, before_s, time_s = line["entry"], last_s, theatre_time_s(line)
        last_s = time_s
        host_time = str(line.get("host_time", ""))
        if entry == Entry.INTENT:
            row = str(line.get("step", ""))
            open_now["step"] = len(spans)
            spans.append(Span("step", row, row, time_s, time_s, "", host_time))
        elif entry in STEP_ENDS:
            _end(spans, open_now, "step", time_s, STEP_ENDS[Entry(str(entry))])
            row = BETWEEN_STEPS
        elif entry == Entry.HOME:
            row = BETWEEN_STEPS
        elif entry == Entry.RESTARTED:  # what the program before it had begun ended with it
            _end_all(spans, open_now, before_s, "interrupted")
            row = BETWEEN_STEPS
        elif entry == Entry.MOTION:
            open_now[f"motion {line.get('number')}"] = len(spans)
            spans.append(Span("motion", str(line.get("what", "")), row, time_s, time_s, "", host_time))
        elif entry == Entry.MOVED:
            _end(spans, open_now, f"motion {line.get('number')}", time_s, str(line.get("error", "done")))
        elif entry == Entry.RESTED:
            open_now["rest"] = len(spans)
            name = f"{line.get('state', 'rest')}: {line.get('reason', '')}"
            spans.append(Span("rest", name, row, time_s, time_s, "", host_time))
        elif entry == Entry.RESUMED:
            _end(spans, open_now, "rest", time_s, "done")
    _end_all(spans, open_now, last_s, "not ended")
    return tuple(spans)


def _end_all(spans: list[Span], open_now: dict[str, int], time_s: float, ended: str) -> None:
    for key in tuple(open_now):
        _end(spans, open_now, key, time_s, ended)


def _end(spans: list[Span], open_now: dict[str, int], key: str, time_s: float, ended: str) -> None:
    place = open_now.pop(key, None)
    if place is not None:
        spans[place] = replace(spans[place], end_s=max(time_s, spans[place].begin_s), ended=ended)
