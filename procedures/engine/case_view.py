"""Immutable snapshot of a case for display, folded from the case's events.

Terminal and console draw from the same snapshot. The fold is pure; it is fed by the engine's stream, its
socket or a run's file.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from procedures.engine import events
from procedures.journal.journal import Entry
from procedures.operator.question import YES, Topic

RATE_OVER_S = 1.0  # theatre time
NOTICES_KEPT = 40
JOURNAL_KEPT = 200
MOST_DEVICES = 64  # every stored view has them all: a file of others cost 665 MB
OPENING = "opening"  # before the engine reports a state
K = TypeVar("K")
V = TypeVar("V")
FAULT, REFUSED, FINDING = "fault", "refused", "finding"  # kinds of notices


@dataclass(frozen=True)
class StepRow:
    """A step, in case order, and its outcome."""

    step: str
    title: str
    phase: str
    moves: bool
    state: str = ""  # begun, done, failed, interrupted, superseded; empty: not yet
    summary: str = ""
    record: str | None = None
    doubt: str = ""  # the fault of an arm that came after the result


@dataclass(frozen=True)
class Rate:
    """Counts per second of theatre time, over the last second or longer."""

    count: int
    since_s: float  # when it was that many
    hz: float | None = None

    def at(self, count: int, now_s: float) -> Rate:
        """Return the updated rate. A count that has decreased means counting has restarted."""
        if count < self.count:
            return Rate(count, now_s)
        span_s = now_s - self.since_s
        return self if span_s < RATE_OVER_S else Rate(count, now_s, (count - self.count) / span_s)


@dataclass(frozen=True)
class DeviceRow:
    """A device as last reported."""

    seen: events.DeviceState
    age_s: float | None = None  # of its latest reading, theatre time
    validity: str = ""  # of that reading
    rate: Rate | None = None  # of its readings


@dataclass(frozen=True)
class ReportedPose:
    """Pose of an arm, and the theatre time of its report."""

    pose: events.Pose
    reported_s: float

    def age_s(self, now_s: float) -> float:
        """Return the age of the joints at a theatre time."""
        return now_s - self.reported_s + self.pose.age_s


@dataclass(frozen=True)
class Notice:
    """A fault, refusal or finding and the recommended action."""

    kind: str
    theatre_time_s: float
    what: str  # of a refusal, the unmet preconditions
    advice: str = ""
    code: str = ""
    step: str = ""  # the step it happened in
    retried: bool = False  # that step has begun again, or the fault was acknowledged
    settled: bool = False  # that step has finished


@dataclass(frozen=True)
class CaseView:
    """The case after event `number`. `fact` is the number of the last event that is not a signal."""

    number: int = 0
    fact: int = 0
    theatre_time_s: float = 0.0
    host_time: str = ""
    run: str = ""
    theatre: str = ""
    banner: str | None = None  # None: not reported yet; empty: hardware
    strategy: str = ""
    methods: str = ""  # localizer and matcher, unless both are for clinical use
    state: str = OPENING
    reason: str = ""
    steps: tuple[StepRow, ...] = ()
    running: str = ""
    latest_step: str = ""  # the step that began or ended last
    share: float = 0.0  # of that step
    doing: str = ""
    scan: events.ScanProgress | None = None  # of the skin, until a result is superseded
    waiting: events.Waiting | None = None
    question: events.Questioned | None = None
    asked_at: str = ""  # host time
    seat: events.Seat | None = None
    devices: dict[str, DeviceRow] = field(default_factory=dict)
    link: events.LinkHealth | None = None
    link_said_s: float = 0.0  # when that was reported, theatre time
    link_rate: Rate | None = None  # of its cycles
    bodies: dict[str, events.Bodies] = field(default_factory=dict)  # by arm, that with the guide first
    volume: events.MeasuringVolume | None = None
    poses: dict[str, ReportedPose] = field(default_factory=dict)  # by arm
    apart: dict[tuple[str, str], events.ArmsApart] = field(default_factory=dict)  # by both arms
    notices: tuple[Notice, ...] = ()
    journal: tuple[dict[str, Any], ...] = ()  # latest lines
    lost_signals: int = 0  # that a run's file does not hold
    results: int = 0  # number of results added or superseded so far
    closings: int = 0  # of programs that had the run
    outcome: str = ""  # of a closed run: by its journal, and as the page tells it by its folder
    ending: str = ""  # in a sentence

    @property
    def mode(self) -> str:
        """Operating mode of the controller, as last reported."""
        facts = (fact for row in self.devices.values() for fact in row.seen.says)
        return next((fact.found for fact in facts if fact.name == "operating mode"), "")

    @property
    def tool_with_guide_mm(self) -> tuple[events.Ends, ...]:
        """Axes of the tool of the arm with the guide; empty if they are not known."""
        for arm, bodies in self.bodies.items():
            if bodies.with_guide and arm in self.poses:
                return self.poses[arm].pose.bodies_mm[bodies.links :]
        return ()

    @property
    def awaits_order(self) -> bool:
        """Whether the case waits for an order, with something left to do."""
        return self.waiting is not None and self.waiting.upcoming is not None

    @property
    def upcoming(self) -> str:
        """Next step, as far as can be told from the events."""
        if self.waiting is not None:
            return self.waiting.upcoming or ""
        return next((row.step for row in self.steps if row.state != "done" and row.step != self.running), "")


def fold(view: CaseView, event: events.Event) -> CaseView:
    """Return the view after one more event."""
    changed = replace(
        view,
        number=event.number,
        fact=view.fact if event.what.signal else event.number,
        theatre_time_s=event.theatre_time_s,
        host_time=event.host_time.isoformat(timespec="milliseconds"),
    )
    changed = replace(changed, **_changes(changed, event.what))
    if event.what.signal and event.number < view.number:  # written late to a run's file
        return replace(
            changed, number=view.number, theatre_time_s=view.theatre_time_s, host_time=view.host_time
        )
    return changed


def _with(known: dict[K, V], key: K, value: V) -> dict[K, V]:
    """Return a mapping with one more entry, or as it is if it has no room for another."""
    return {**known, key: value} if key in known or len(known) < MOST_DEVICES else known


def _changes(view: CaseView, what: events.EventContent) -> dict[str, Any]:
    match what:
        case events.CaseState(state=state, reason=reason):
            return {"state": state, "reason": reason}
        case events.StepState() as step:
            return _step_changes(view, step)
        case events.Progress(step=step, share=share, text=text, scan=scan):
            known = {"share": share, "doing": text, "scan": scan or view.scan}
            return known if step == view.running else {}
        case events.Questioned():
            return {"question": what, "asked_at": view.host_time}
        case events.Answered(question=number) as answer:
            is_other_open = view.question is not None and view.question.question != number
            return {} if is_other_open else {"question": None, "steps": _without_doubt(view, answer)}
        case events.Seat():
            return {"seat": what if what.holder else None}
        case events.Order(steps=steps):
            done_count = sum(item.record is not None for item in steps)
            return {"steps": tuple(map(_to_row, steps)), "results": view.results + done_count}
        case events.Waiting():
            return {"waiting": what}
        case events.Bodies():
            bodies = _with(view.bodies, what.arm, what)  # its events come in any order to who joins late
            return {"bodies": dict(sorted(bodies.items(), key=lambda one: not one[1].with_guide))}
        case events.MeasuringVolume():
            return {"volume": what}
        case events.LinkHealth():
            now_s = view.theatre_time_s
            return {
                "link": what,
                "link_said_s": now_s,
                "link_rate": _update_rate(view.link_rate, what.cycles, now_s),
            }
        case events.Pose():
            return {"poses": _with(view.poses, what.arm, ReportedPose(what, view.theatre_time_s))}
        case events.ArmsApart():
            return {"apart": _with(view.apart, what.arms, what)}
        case events.DeviceState(device=device) | events.DeviceAge(device=device):
            return _device_changes(view, device, what)
        case events.JournalLine(line=line):
            return _journal_changes(view, line)
        case events.SignalsLost(count=count):
            return {"lost_signals": count}  # of the file alone; the view has the latest of each
        case events.Fault() | events.Refusal() | events.Advisory():
            return {"notices": (*view.notices, _make_notice(view, what))[-NOTICES_KEPT:]}


def _to_row(item: events.OrderedStep) -> StepRow:
    state = "" if item.record is None else "done"
    return StepRow(item.step, item.title, item.phase, item.moves, state, record=item.record, doubt=item.doubt)


def _step_changes(view: CaseView, step: events.StepState) -> dict[str, Any]:
    if step.state == "superseded":
        rows = tuple(
            replace(row, state="superseded", summary=step.summary or row.summary)
            if row.record == step.record
            else row
            for row in view.steps
        )
        return {"steps": rows, "results": view.results + 1, "scan": None}
    rows = tuple(
        replace(row, state=step.state, summary=step.summary, record=step.record or row.record, doubt="")
        if row.step == step.step
        else row
        for row in view.steps
    )
    changes: dict[str, Any] = {"steps": rows, "latest_step": step.step, "running": "", "waiting": None}
    if step.state == "begun":
        notices = _mark_notices(view.notices, step.step, retried=True)
        return changes | {"running": step.step, "share": 0.0, "doing": "", "notices": notices}
    if step.state == "done":
        notices = _mark_notices(view.notices, step.step, settled=True)
        return changes | {"results": view.results + 1, "notices": notices}
    return changes


def _without_doubt(view: CaseView, answer: events.Answered) -> tuple[StepRow, ...]:
    """Return the rows of the steps, without the doubts that the answer has settled."""
    topic, _, place = ("" if view.question is None else view.question.topic).partition(":")
    if topic != Topic.REGISTRATION_KEPT or answer.answer != YES:
        return view.steps
    return tuple(replace(row, doubt="") if row.step.endswith(f":{place}") else row for row in view.steps)


def _mark_notices(
    notices: tuple[Notice, ...], step: str, *, retried: bool = False, settled: bool = False
) -> tuple[Notice, ...]:
    """Mark the notices of a step, except for findings."""
    return tuple(
        replace(item, retried=item.retried or retried, settled=item.settled or settled)
        if item.step == step and item.kind != FINDING
        else item
        for item in notices
    )


def _device_changes(
    view: CaseView, device: str, what: events.DeviceState | events.DeviceAge
) -> dict[str, Any]:
    known = view.devices.get(device)
    if isinstance(what, events.DeviceState):
        if known is None and len(view.devices) == MOST_DEVICES:
            return {}
        row = replace(known, seen=what) if known else DeviceRow(what)
    elif known is None:
        return {}
    else:
        count, now_s = what.readings, view.theatre_time_s
        rate = None if count is None else _update_rate(known.rate, count, now_s)
        row = DeviceRow(known.seen, what.age_s, what.validity, rate)
    return {"devices": {**view.devices, device: row}}


def _update_rate(before: Rate | None, count: int, now_s: float) -> Rate:
    return before.at(count, now_s) if before else Rate(count, now_s)


def _make_notice(view: CaseView, what: events.Fault | events.Refusal | events.Advisory) -> Notice:
    match what:
        case events.Fault(code=code, what=text, advice=advice):
            text = text.removesuffix(advice).rstrip()
            text = text.removeprefix(f"{code}: ")
            return Notice(FAULT, view.theatre_time_s, text, advice, code, step=view.running or view.upcoming)
        case events.Refusal(step=step, unmet=unmet):
            return Notice(REFUSED, view.theatre_time_s, "; ".join(unmet), step=step)
        case events.Advisory(text=text):
            return Notice(FINDING, view.theatre_time_s, text)


def _journal_changes(view: CaseView, line: dict[str, Any]) -> dict[str, Any]:
    changes: dict[str, Any] = {"journal": (*view.journal, line)[-JOURNAL_KEPT:]}
    match line.get("entry"):
        case Entry.OPENED | Entry.RESTARTED:  # of a session: anything the last one left open is over
            changes |= {"outcome": "", "ending": "", "running": "", "question": None, "seat": None}
            named = ("run", "theatre", "banner", "strategy", "methods")
            changes |= {name: str(line.get(name) or "") for name in named}
        case Entry.DOUBTED:
            doubted, fault = line.get("steps") or (), str(line.get("fault") or "")
            changes["steps"] = tuple(
                replace(row, doubt=fault) if row.step in doubted else row for row in view.steps
            )
        case Entry.CLOSED:
            changes |= {"outcome": str(line.get("outcome") or ""), "closings": view.closings + 1}
        case Entry.ACKNOWLEDGED:
            changes["notices"] = tuple(
                replace(item, retried=True) if _is_acknowledged(item, line) else item for item in view.notices
            )
    return changes


def _is_acknowledged(notice: Notice, line: dict[str, Any]) -> bool:
    """Whether a journal line acknowledges the fault of a notice, or one that caused its refusal."""
    code = str(line.get("fault")).partition(": ")[0]
    text = f"{notice.code}: {notice.what}"
    return f"the {line.get('device')} is in fault" in text or f"{code}: " in text
