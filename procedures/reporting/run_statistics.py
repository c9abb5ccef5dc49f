"""Time spent per step, and link counters, from a run's journal and log.

Theatre time is that of the procedure; with real devices it is wall-clock time, while a simulated theatre in
lock-step adds none while the computer works or a script answers. Host time is what the computer took.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, Literal, NamedTuple

from procedures.journal.journal import ENDS_OF_A_STEP, Entry, Line, theatre_time_s
from procedures.steps.catalogue import name_every_step
from ronna_hw.text import format_count

BETWEEN_STEPS = "between steps"
STEP_ENDS = {Entry.RESULT: "done", Entry.FAILED: "failed", Entry.INTERRUPTED: "interrupted"}
PHASE, STEP, QUESTION, HANDS = "phase", "step", "question", "hands"
# Thesis 5.1: time to find the markers in a CT, by an operator and by the algorithm.
OPERATOR_S, ALGORITHM_S = 191.5, 28.8
ALGORITHM_PROCESSOR = "Intel i7-6700HQ"
LOCALIZATION = "fiducial_localization"
OUTSIDE = "outside the steps"
PHASES: Mapping[str, str] = {name: step.phase.value for name, step in name_every_step().items()}
ACTIVE = "active"  # the state that a device left
CONNECTED = "connected"  # the event with which counters of the connection begin
LINK = "link"  # what a connection counts, from its beginning
FRAME = ("timestamp", "level", "event", "device", "before")


@dataclass(frozen=True)
class Span:
    """Period of theatre time; `row` is the step to which it belongs."""

    kind: Literal["step", "motion", "rest"]
    name: str
    row: str
    begin_s: float
    end_s: float
    ended: str  # done, failed, interrupted, an error code, or `not ended`
    host_time: str  # when it began


def timeline(journal: Sequence[Line]) -> tuple[Span, ...]:
    """Return the spans by start time. A span without an end lasts until its program's last line."""
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
            _end_span(spans, open_now, "step", time_s, STEP_ENDS[Entry(str(entry))])
            row = BETWEEN_STEPS
        elif entry == Entry.HOME:
            row = BETWEEN_STEPS
        elif entry == Entry.RESTARTED:  # what the program before it had begun ended with it
            _end_spans(spans, open_now, before_s, "interrupted")
            row = BETWEEN_STEPS
        elif entry == Entry.MOTION:
            open_now[f"motion {line.get('number')}"] = len(spans)
            spans.append(Span("motion", str(line.get("what", "")), row, time_s, time_s, "", host_time))
        elif entry == Entry.MOVED:
            _end_span(spans, open_now, f"motion {line.get('number')}", time_s, str(line.get("error", "done")))
        elif entry == Entry.RESTED:
            open_now["rest"] = len(spans)
            name = f"{line.get('state', 'rest')}: {line.get('reason', '')}"
            spans.append(Span("rest", name, row, time_s, time_s, "", host_time))
        elif entry == Entry.RESUMED:
            _end_span(spans, open_now, "rest", time_s, "done")
    _end_spans(spans, open_now, last_s, "not ended")
    return tuple(spans)


def _end_spans(spans: list[Span], open_now: dict[str, int], time_s: float, ended: str) -> None:
    for key in tuple(open_now):
        _end_span(spans, open_now, key, time_s, ended)


def _end_span(spans: list[Span], open_now: dict[str, int], key: str, time_s: float, ended: str) -> None:
    place = open_now.pop(key, None)
    if place is not None:
        spans[place] = replace(spans[place], end_s=max(time_s, spans[place].begin_s), ended=ended)


@dataclass(frozen=True)
class TimeTaken:
    """Total time of one phase, step, or human action."""

    kind: str
    name: str
    count: int
    theatre_s: float
    host_s: float | None  # unknown for an answer: the journal has only its end


def times_taken(journal: Sequence[Line]) -> tuple[TimeTaken, ...]:
    """Return times for phases and steps in order of first occurrence, then for questions and manual work.

    Steps of all trajectories are added up. A step that was restarted counts again; one that never ended
    counts until the last line of its program.
    """
    found: dict[tuple[str, str], list[tuple[float, float | None]]] = {}

    def add(kind: str, name: str, theatre_s: float, host_s: float | None) -> None:
        found.setdefault((kind, name), []).append((theatre_s, host_s))

    begun: Line | None = None
    before: Line | None = None
    for line in (*journal, None):
        is_over = line is None or line["entry"] == Entry.RESTARTED  # with it the clock of its program
        ends = line is None or is_over or line["entry"] == Entry.INTENT or line["entry"] in ENDS_OF_A_STEP
        last, before = before if is_over else line, line
        if begun is not None and last is not None and ends:
            name = str(begun.get("step", "")).partition(":")[0]
            took = theatre_time_s(last) - theatre_time_s(begun), _host_s(begun, last)
            add(PHASE, PHASES.get(name, OUTSIDE), *took)
            add(STEP, name, *took)
            begun = None
        if line is None:
            break
        if line["entry"] == Entry.INTENT:
            begun = line
        elif line["entry"] == Entry.CONFIRMATION:
            add(QUESTION, str(line.get("topic")).partition(":")[0], _elapsed_s(line, "asked_s"), None)
        elif line["entry"] == Entry.WORK:
            add(HANDS, str(line.get("task", "")), _elapsed_s(line, "began_s"), None)
    kinds = (PHASE, STEP, QUESTION, HANDS)
    times = []
    for (kind, name), each in sorted(found.items(), key=lambda item: kinds.index(item[0][0])):
        host_s = sum(host_s or 0.0 for _, host_s in each) if kind in (PHASE, STEP) else None
        times.append(TimeTaken(kind, name, len(each), sum(theatre_s for theatre_s, _ in each), host_s))
    return tuple(times)


def _elapsed_s(line: Line, key: str) -> float:
    """Return the theatre time elapsed since the time stored under a key, or 0 if the key is missing."""
    began = line.get(key)
    return max(0.0, theatre_time_s(line) - float(began)) if isinstance(began, int | float) else 0.0


def _host_s(begin: Line, end: Line) -> float:
    try:
        began, ended = (datetime.fromisoformat(str(line["host_time"])) for line in (begin, end))
        return max(0.0, (ended - began).total_seconds())
    except (KeyError, ValueError, TypeError):  # TypeError: only one of them has a time zone
        return 0.0


class DeviceCounters(NamedTuple):
    """Counters of a device in words, summed over its active periods."""

    device: str
    periods: str
    counters: str


def link_counters(log: Sequence[Mapping[str, Any]]) -> tuple[DeviceCounters, ...]:
    """Return the summed counters of each device that counted anything."""
    totals: dict[str, _Totals] = {}
    for line in log:
        if "device" not in line:
            continue
        of_device = totals.setdefault(str(line["device"]), _Totals())
        if line.get("event") == CONNECTED:
            of_device.connection.clear()
        elif line.get("before") == ACTIVE:
            of_device.add(line)
    counters = []
    for device, one in totals.items():
        counts = ", ".join(f"{name} {count}" for name, count in one.sums.items())
        if counts:
            counters.append(DeviceCounters(device, format_count(one.times, "time"), counts))
    return tuple(counters)


@dataclass
class _Totals:
    """Sums over a device's active periods. Connection counters continue across periods."""

    times: int = 0
    sums: dict[str, int | float] = field(default_factory=dict)
    connection: dict[str, int | float] = field(default_factory=dict)  # its counters at the end before

    def add(self, line: Mapping[str, Any]) -> None:
        link = line.get(LINK)
        continuing = dict(_counters(link, "")) if isinstance(link, Mapping) else {}
        counts = list(_counters(line, ""))
        self.times += bool(counts)
        for name, count in counts:
            since = self.connection.get(name, 0) if continuing.get(name) == count else 0
            self.sums[name] = self.sums.get(name, 0) + count - since
        self.connection |= continuing


def _counters(value: Mapping[str, Any], where: str) -> Iterator[tuple[str, int | float]]:
    for key, one in value.items():
        name = f"{where} {key}".strip().replace("_", " ")
        if key in FRAME or isinstance(one, bool):
            continue
        if isinstance(one, int | float):
            yield name, one
        elif isinstance(one, Mapping):
            yield from _counters(one, "" if not where and key in ("frames", LINK) else name)
        elif isinstance(one, list):
            for number, item in enumerate(one, 1):
                if isinstance(item, Mapping):
                    yield from _counters(item, f"{name} {number}")
