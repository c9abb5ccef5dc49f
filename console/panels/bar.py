"""The head of the page: which case, in which theatre, at what time, and who operates it."""

from __future__ import annotations

from console.feed.view import CaseView
from console.panels.html import tag, text

OPENING, HARDWARE = "OPENING", "HARDWARE: A REAL ROBOT MOVES"


def banner(view: CaseView) -> str:
    """Simulated or hardware; they must never be confused."""
    if view.banner is None:
        return tag("div", OPENING, class_="banner opening")
    if view.banner:
        return tag("div", f"◇ {text(view.banner)}", class_="banner simulated")
    return tag("div", f"⚠ {HARDWARE}", class_="banner hardware")


def case_line(view: CaseView) -> str:
    """The run, its theatre and strategy."""
    run = tag("b", text(view.run or "no run yet"))
    more = ", ".join(part for part in (view.theatre, view.strategy and f"strategy {view.strategy}") if part)
    ended = tag("span", f" closed: {text(view.outcome)}", class_="warn") if view.outcome else ""
    return tag("div", f'{run}{ended}<div class="dim">{text(more)}</div>', class_="case")


def clock(view: CaseView, beat: int) -> str:
    """Theatre time, with a number that changes while the page is updated."""
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
    """Who is in the operator's seat, and what this page may do."""
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
