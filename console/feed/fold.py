"""`fold`: the new state from an event and the previous state. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from console.feed.view import CaseView, DeviceRow, Notice, Rate, StepRow, StoodPose
from procedures.engine.events import (
    Advisory,
    Answered,
    Bodies,
    CaseState,
    DeviceAge,
    DeviceState,
    Event,
    Fault,
    Happening,
    JournalLine,
    LinkHealth,
    MeasuringVolume,
    Order,
    OrderedStep,
    Pose,
    Progress,
    Questioned,
    Refusal,
    Seat,
    SignalsLost,
    StepState,
    Waiting,
)

NOTICES_KEPT = 40
JOURNAL_KEPT = 200
MOST_DEVICES = 64  # every stored view has them all: a file of others cost 665 MB
BEGINNINGS, CLOSED = ("opened", "restarted"), "closed"


def fold(view: CaseView, event: Event) -> CaseView:
    """The view after one more event."""
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


def _changes(view: CaseView, what: Happening) -> dict[str, Any]:
    match what:
        case CaseState(state=state, reason=reason):
            return {"state": state, "reason": reason}
        case StepState() as step:
            return _step(view, step)
        case Progress(step=step, share=share, text=text):
            return {"share": share, "doing": text} if step == view.running else {}
        case Questioned():
            return {"question": what, "asked_at": view.host_time}
        case Answered(question=number):
            stands = view.question is not None and view.question.question != number
            return {} if stands else {"question": None}
        case Seat():
            return {"seat": what if what.holder else None}
        case Order(steps=steps):
            standing = sum(one.record is not None for one in steps)
            return {"steps": tuple(map(_ordered, steps)), "results": view.results + standing}
        case Waiting():
            return {"waiting": what}
        case Bodies():
            return {"bodies": what}
        case MeasuringVolume():
            return {"volume": what}
        case LinkHealth():
            now_s = view.theatre_time_s
            return {
                "link": what,
                "link_said_s": now_s,
                "link_rate": _rate(view.link_rate, what.cycles, now_s),
            }
        case Pose():
            return {"pose": StoodPose(what, view.theatre_time_s)}
        case DeviceState(device=device) | DeviceAge(device=device):
            return _device(view, device, what)
        case JournalLine(line=line):
            return _journal(view, line)
        case SignalsLost():
            return {}  # of the file; the picture has the latest of each
        case Fault() | Refusal() | Advisory():
            return {"notices": (*view.notices, _notice(view, what))[-NOTICES_KEPT:]}


def _ordered(one: OrderedStep) -> StepRow:
    state = "" if one.record is None else "done"
    return StepRow(one.step, one.title, one.phase, one.moves, state, record=one.record)


def _step(view: CaseView, step: StepState) -> dict[str, Any]:
    if step.state == "superseded":
        rows = tuple(
            replace(row, state="superseded", summary=step.summary or row.summary)
            if row.record == step.record
            else row
            for row in view.steps
        )
        return {"steps": rows, "results": view.results + 1}
    rows = tuple(
        replace(row, state=step.state, summary=step.summary, record=step.record or row.record)
        if row.step == step.step
        else row
        for row in view.steps
    )
    begun = step.state == "begun"
    return {
        "steps": rows,
        "notices": _settled(view.notices, step.step) if step.state == "done" else view.notices,
        "running": step.step if begun else "",
        "share": 0.0,
        "doing": "",
        "waiting": None,
        "results": view.results + (step.state == "done"),
    }


def _settled(notices: tuple[Notice, ...], step: str) -> tuple[Notice, ...]:
    """Mark notices as settled once their step is done, including what a fault left to be done there."""
    return tuple(
        replace(one, settled=True) if one.step == step and one.kind != "finding" else one for one in notices
    )


def _device(view: CaseView, device: str, what: DeviceState | DeviceAge) -> dict[str, Any]:
    known = view.devices.get(device)
    if isinstance(what, DeviceState):
        if known is None and len(view.devices) == MOST_DEVICES:
            return {}
        row = replace(known, seen=what) if known else DeviceRow(what)
    elif known is None:
        return {}
    else:
        count, now_s = what.readings, view.theatre_time_s
        rate = None if count is None else _rate(known.rate, count, now_s)
        row = DeviceRow(known.seen, what.age_s, what.validity, rate)
    return {"devices": {**view.devices, device: row}}


def _rate(before: Rate | None, count: int, now_s: float) -> Rate:
    return before.at(count, now_s) if before else Rate(count, now_s)


def _notice(view: CaseView, what: Fault | Refusal | Advisory) -> Notice:
    match what:
        case Fault(code=code, what=text, advice=advice):
            text = text.removesuffix(advice).rstrip()
            text = text.removeprefix(f"{code}: ")
            return Notice(
                "fault", view.theatre_time_s, text, advice, code, step=view.running or view.upcoming
            )
        case Refusal(step=step, unmet=unmet):
            refused = f"{step} cannot start: {'; '.join(unmet)}"
            return Notice("refused", view.theatre_time_s, refused, step=step)
        case Advisory(text=text):
            return Notice("finding", view.theatre_time_s, text)


def _journal(view: CaseView, line: dict[str, Any]) -> dict[str, Any]:
    entry = str(line.get("entry"))
    about = next((line[name] for name in ("step", "what", "topic", "device", "text") if name in line), "")
    changes: dict[str, Any] = {
        "journal": (*view.journal, f"{line.get('sequence')} {entry} {about}".rstrip())[-JOURNAL_KEPT:]
    }
    if entry in BEGINNINGS:  # of a session: anything the last one left open is over
        changes |= {
            "outcome": "",
            "running": "",
            "question": None,
            "seat": None,
            "run": str(line.get("run") or ""),
            "theatre": str(line.get("theatre") or ""),
            "banner": str(line.get("banner") or ""),
            "strategy": str(line.get("strategy") or ""),
        }
    elif entry == CLOSED:
        changes["outcome"] = str(line.get("outcome") or "")
    return changes
