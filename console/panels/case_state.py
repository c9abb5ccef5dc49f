"""Panels for the state of a case: page head, step progress, devices and the robot link."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

from console.panels.html import head_row, table_of, tag, text
from procedures.engine.case_view import CaseView, DeviceRow, Rate, StepRow
from ronna_hw.text import format_count

OPENING, HARDWARE = "OPENING", "HARDWARE: A REAL ROBOT MOVES"
MARKS = {  # a symbol per state, so that nothing is conveyed by colour alone
    "done": ("✓", "done", "ok"),
    "begun": ("▶", "now", "now"),
    "failed": ("✗", "failed", "bad"),
    "interrupted": ("■", "interrupted", "bad"),
    "superseded": ("~", "superseded", "warn"),
    "doubted": ("?", "in doubt", "warn"),
    "next": ("→", "next", "next"),
    "": ("·", "pending", "dim"),
}
OLD_S = 2.0  # theatre time after which a reading is shown as old
SIGNS = {"fault": ("✗", "bad"), "active": ("●", "ok"), "hold": ("■", "warn"), "closed": ("○", "dim")}
HEAD = ("device", "state", "reading", "rate", "says", "fault")
WHOLE = ("", "ok")  # validities that need not be mentioned


def banner(view: CaseView) -> str:
    """Show whether the case is simulated or runs on hardware. The two must never be confused."""
    if view.banner is None:
        return tag("div", OPENING, class_="banner opening")
    if view.banner:
        return tag("div", f"◇ {text(view.banner)}", class_="banner simulated")
    return tag("div", f"⚠ {HARDWARE}", class_="banner hardware")


def case_line(view: CaseView) -> str:
    run = tag("b", text(view.run or "no run yet"))
    strategy = view.strategy and f"strategy {view.strategy}"
    more = ", ".join(part for part in (view.theatre, strategy, view.methods) if part)
    ended = tag("span", f" closed: {text(view.outcome)}", class_="warn") if view.outcome else ""
    return tag("div", f'{run}{ended}<div class="dim">{text(more)}</div>', class_="case")


def clock(view: CaseView, beat: int) -> str:
    """Show the theatre time, with a beat number that changes as long as the page is updated."""
    return tag(
        "div",
        tag("span", f"{view.theatre_time_s:.1f} s", class_="num") + '<div class="dim">theatre time</div>',
        id="clock",
        class_="clock",
        data_n=str(view.number),
        data_fact=str(view.fact),
        data_beat=str(beat),
        data_outcome=view.outcome,
    )


def seat_line(view: CaseView, *, is_mine: bool, may_operate: bool) -> str:
    holder = view.seat.holder if view.seat else ""
    if is_mine:
        words, kind = f"You are operating as {holder}", "ok"
    elif holder:
        words, kind = f"{holder} is operating; you are viewing", ""
    elif may_operate:
        words, kind = "The operator's seat is empty", "warn"
    else:
        words, kind = "You are viewing; no one is operating from a page", "dim"
    return tag("div", text(words), class_=f"seat {kind}", role="status")


def advice(view: CaseView, *, is_mine: bool, may_operate: bool) -> str:
    """Say what happens and what to do while nothing is asked."""
    if view.question is not None:
        return ""
    heading, words = _advise(view, is_mine=is_mine, may_operate=may_operate)
    body = tag("h2", text(heading)) + tag("p", text(words))
    return tag("section", body, class_="card advicebox", data_runs=view.running)


def _advise(view: CaseView, *, is_mine: bool, may_operate: bool) -> tuple[str, str]:
    if view.outcome:
        where = "Its results are below, and in the run's report.html."
        return f"The case is closed: {view.outcome}", f"{view.ending} {where}".strip()
    if not view.steps:
        return "The theatre is opening", "Nothing to do yet: the first step appears here."
    step = _find_title(view, view.running or view.upcoming)
    if view.waiting is None or not view.upcoming:
        if step:
            return f"Now: {step}", "Nothing to answer at the moment."
        return "Nothing left to run", (
            "A case that is run by itself closes now. One that is stepped is closed in its terminal: "
            "quit writes its report and seals it."
        )
    if view.seat is None and may_operate:
        return "Take the seat to operate", (
            f"Type your name at the top and press Take the seat. Next then runs: {step}. "
            "Without the seat you can only watch."
        )
    if view.waiting.unmet:
        return f"Cannot start yet: {step}", "Put right what is listed under Progress, then press Next."
    if is_mine:
        return f"Next: {step}", (
            "Press Next to run this step; or choose a step and press Run to. "
            "Run on goes to the end. Either stops at every question."
        )
    who = f"{view.seat.holder} operates" if view.seat else "No one is operating"
    return f"Next: {step}", f"{who}. You are watching."


def _find_title(view: CaseView, step: str) -> str:
    """Return a step's title with its trajectory. Bringing the arm home is no step of its own."""
    title = next((row.title for row in view.steps if row.step == step), step)
    _, _, place = step.partition(":")
    return f"{title} {place}".rstrip()


def chart(view: CaseView) -> str:
    """Show the steps by phase, collapsing completed phases until all are complete."""
    finished = all(row.state == "done" for row in view.steps)
    latest = next((row for row in reversed(view.steps) if row.state == "done"), None)
    phases = []
    for phase, rows in groupby(view.steps, key=lambda row: row.phase):
        steps = list(rows)
        done = all(row.state == "done" for row in steps)
        words = (
            f"{phase.capitalize()}: {format_count(len(steps), 'step')} done" if done else phase.capitalize()
        )
        body = tag("summary", text(words))
        body += tag(
            "ol", "".join(_render_step(view, row, with_summary=finished or row is latest) for row in steps)
        )
        phases.append(f"<details{'' if done and not finished else ' open'}>{body}</details>")
    return _render_state(view) + ("".join(phases) or tag("p", "Opening the theatre.", class_="dim"))


def chart_key(view: CaseView) -> object:
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


def _render_state(view: CaseView) -> str:
    state = tag("strong", text(view.state.replace(".", " · ").replace("_", " ")))
    reason = tag("div", text(view.reason), class_="warn") if view.reason else ""
    unmet = view.waiting.unmet if view.waiting else ()
    refused = "".join(tag("li", text(item)) for item in unmet)
    refusal_html = (
        tag("div", f"{text(view.upcoming)} cannot start:" + tag("ul", refused), class_="bad") if unmet else ""
    )
    waiting_html = ""
    if view.waiting is not None and not unmet and view.upcoming and view.question is None:
        waiting_html = tag("div", f"waiting for the operator; next: {text(view.upcoming)}", class_="next")
    return tag("div", state + reason + waiting_html + refusal_html, class_="state", role="status")


def _render_step(view: CaseView, row: StepRow, *, with_summary: bool) -> str:
    is_next = row.state not in ("begun", "done") and row.step == view.upcoming and not view.running
    is_doubted = row.state == "done" and bool(row.doubt)
    state = "next" if is_next and not row.state else "doubted" if is_doubted else row.state
    sign, word, kind = MARKS[state]
    moves = tag("span", "moves", class_="moves") if row.moves else ""
    shown = tag("span", sign, class_="mark", aria_hidden="true") + tag(
        "span", f"{text(row.title)} {_render_place(row)}{moves}", class_="title"
    )
    detail_text = row.summary if with_summary or row.state != "done" else ""
    if is_doubted:
        detail_text = f"older than {row.doubt}: it is used only if the operator keeps it"
    if row.state == "begun":
        detail_text = f"{view.share:.0%} {view.doing}".strip() if view.share or view.doing else ""
        shown += tag("progress", "", max="1", value=f"{view.share:.3f}", aria_label="progress")
    detail = tag("div", text(detail_text), class_="summary") if detail_text else ""
    return tag("li", shown + tag("span", word, class_="word") + detail, class_=kind, data_step=row.step)


def _render_place(row: StepRow) -> str:
    _, _, place = row.step.partition(":")
    return tag("b", text(place)) + " " if place else ""


def devices(view: CaseView) -> str:
    if not view.devices:
        return tag("p", "No device connected yet.", class_="dim")
    body = "".join(
        _render_row(name, row if not view.outcome else replace(row, age_s=None))  # ages end with the case
        for name, row in view.devices.items()
    )
    return _render_link(view) + table_of(head_row(*HEAD), body)


def devices_key(view: CaseView) -> object:
    return tuple((name, row.seen, _format_age(row), row.rate) for name, row in view.devices.items()), (
        view.link,
        view.outcome,
    )


def mode(view: CaseView) -> str:
    if not view.mode:
        return tag("div", '<b>-</b><div class="dim">controller</div>', class_="mode")
    return tag("div", f'<b>{text(view.mode)}</b><div class="dim">controller</div>', class_="mode")


def _render_row(name: str, row: DeviceRow) -> str:
    sign, kind = SIGNS.get(row.seen.state, ("◐", ""))
    state = tag(
        "td",
        f'<span aria-hidden="true">{sign}</span> {text(row.seen.state)}',
        class_=kind,
        data_head="state",
    )
    is_old = row.age_s is not None and row.age_s > OLD_S
    validity_text = "" if row.validity in WHOLE else f" {text(row.validity)}"
    age = tag(
        "td",
        _format_age(row) + (" old" if is_old else "") + validity_text,
        class_="num age warn" if is_old or validity_text else "num age",
        data_head="reading",
    )
    rate = tag("td", _format_rate(row.rate) or "-", class_="num", data_head="rate")
    fault_kind = "bad" if row.seen.fault else "dim"
    fault = tag("td", text(row.seen.fault or "none"), class_=fault_kind, data_head="fault")
    return tag(
        "tr",
        tag("th", text(name), scope="row") + state + age + rate + _render_facts(row) + fault,
        data_device=name,
    )


def _render_facts(row: DeviceRow) -> str:
    """List a device's facts, highlighting those that prevent the case from continuing."""
    remarks = [
        f"{text(fact.name)} {text(fact.found)}"
        if fact.ready
        else tag("strong", f"⚠ {text(fact.name)}: {text(fact.found)}", class_="bad")
        for fact in row.seen.says
    ]
    remarks += [tag("span", f"! {text(item)}", class_="warn") for item in row.seen.notices]
    return tag("td", "; ".join(remarks) or "-", class_="says" if remarks else "dim")


def _format_age(row: DeviceRow) -> str:
    return "-" if row.age_s is None else f"{row.age_s:.1f} s"


def _format_rate(rate: Rate | None) -> str:
    return "" if rate is None or rate.hz is None else f"{rate.hz:.0f} Hz"


def _render_link(view: CaseView) -> str:
    link = view.link
    if link is None:
        return tag("p", "No robot link data yet.", class_="dim")
    rate = f" at {hz}" if (hz := _format_rate(view.link_rate)) else ""
    late = "bad" if link.late or link.lost or link.rejected else ""
    counts = f"{link.late} late, {link.lost} lost, {link.rejected} rejected"
    ago = f"{view.theatre_time_s - view.link_said_s:.0f} s ago"
    when = " at the end" if view.outcome else tag("span", f" {ago}", class_="age")
    return tag(
        "p",
        f"Robot link{when}: {link.cycles} cycles{rate}, "
        + tag("span", counts, class_=late)
        + f"; turnaround {link.turnaround_median_us:.0f} µs median, {link.turnaround_p99_us:.0f} µs p99",
    )
