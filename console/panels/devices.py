"""The devices: state, latest reading, their own reports, faults; the health of the robot link."""

from __future__ import annotations

from console.feed.view import CaseView, DeviceRow, Rate
from console.panels.html import table_of, tag, text

OLD_S = 2.0  # theatre time after which a reading is shown as old
SIGNS = {"fault": ("✗", "bad"), "active": ("●", "ok"), "hold": ("■", "warn"), "closed": ("○", "dim")}
HEAD = ("device", "state", "reading", "rate", "says", "fault")
WHOLE = ("", "ok")  # validities that need not be mentioned


def devices(view: CaseView) -> str:
    """One row per device."""
    if not view.devices:
        return tag("p", "No device connected yet.", class_="dim")
    head = tag("tr", "".join(tag("th", one, scope="col") for one in HEAD))
    body = "".join(_row(name, row) for name, row in view.devices.items())
    return _link(view) + table_of(head, body)


def devices_key(view: CaseView) -> object:
    """Changes when the table does."""
    return tuple((name, row.seen, _age(row), row.rate) for name, row in view.devices.items()), view.link


def mode(view: CaseView) -> str:
    """Operating mode of the controller, for the head of the page."""
    if not view.mode:
        return tag("div", '<b>-</b><div class="dim">controller</div>', class_="mode")
    return tag("div", f'<b>{text(view.mode)}</b><div class="dim">controller</div>', class_="mode")


def _row(name: str, row: DeviceRow) -> str:
    sign, kind = SIGNS.get(row.seen.state, ("◐", ""))
    state = tag("td", f'<span aria-hidden="true">{sign}</span> {text(row.seen.state)}', class_=kind)
    old = row.age_s is not None and row.age_s > OLD_S
    doubt = "" if row.validity in WHOLE else f" {text(row.validity)}"
    age = tag("td", _age(row) + (" old" if old else "") + doubt, class_="num warn" if old or doubt else "num")
    rate = tag("td", _rate(row.rate) or "-", class_="num")
    fault = tag("td", text(row.seen.fault or "none"), class_="bad" if row.seen.fault else "dim")
    return tag(
        "tr", tag("th", text(name), scope="row") + state + age + rate + _says(row) + fault, data_device=name
    )


def _says(row: DeviceRow) -> str:
    """What keeps a case from continuing is highlighted; the rest is listed next to it."""
    remarks = [
        f"{text(fact.name)} {text(fact.found)}"
        if fact.ready
        else tag("strong", f"⚠ {text(fact.name)}: {text(fact.found)}", class_="bad")
        for fact in row.seen.says
    ]
    remarks += [tag("span", f"! {text(one)}", class_="warn") for one in row.seen.notices]
    return tag("td", "; ".join(remarks) or "-", class_="says" if remarks else "dim")


def _age(row: DeviceRow) -> str:
    return "-" if row.age_s is None else f"{row.age_s:.1f} s"


def _rate(rate: Rate | None) -> str:
    return "" if rate is None or rate.hz is None else f"{rate.hz:.0f} Hz"


def _link(view: CaseView) -> str:
    link = view.link
    if link is None:
        return tag("p", "No robot link data yet.", class_="dim")
    rate = f" at {hz}" if (hz := _rate(view.link_rate)) else ""
    late = "bad" if link.late or link.lost or link.rejected else ""
    counts = f"{link.late} late, {link.lost} lost, {link.rejected} rejected"
    return tag(
        "p",
        f"Robot link {view.theatre_time_s - view.link_said_s:.0f} s ago: {link.cycles} cycles{rate}, "
        + tag("span", counts, class_=late)
        + f"; turnaround {link.turnaround_median_us:.0f} µs median, {link.turnaround_p99_us:.0f} µs p99",
    )
