"""The stereo head's view, the measured pairs, and the planned trajectories in the CT."""

from __future__ import annotations

from pathlib import PurePath

from console.feed.view import CaseView
from console.hub import Hub
from console.panels.html import tag, text
from procedures.reporting.case_figures import PLAN_PICTURE, CaseFigures

MOST = 4
OLD_S = 2.0  # host time after which a live image no longer shows the head's view


def live_pair(hub: Hub) -> str:
    """The last pair, with the outlines found in it."""
    if not hub.pair:
        return ""
    age_s = hub.pair_age_s
    old = age_s > OLD_S
    words = f"taken {age_s:.0f} s ago" if old else "now"
    image = f'<img src="/picture/pair?n={hub.pairs}" alt="Both cameras of the stereo head, {words}">'
    caption = tag("figcaption", f"stereo head, {words}", class_="warn" if old else "ok")
    return tag("figure", image + caption, class_="live old" if old else "live")


def live_key(hub: Hub) -> object:
    """Changes when it does."""
    age_s = hub.pair_age_s
    return hub.pairs, int(age_s) if age_s > OLD_S else 0


def pictures(figures: CaseFigures | None) -> str:
    """The measured stereo pairs with the outlines found in them, newest first."""
    names = figures.pictures[-MOST:][::-1] if figures else ()
    if not names:
        return tag("p", "No stereo picture yet.", class_="dim")
    return tag("div", "".join(map(_picture, names)), class_="pictures")


def _picture(name: str) -> str:
    what = PurePath(name).stem.removeprefix("stereo-").replace("-", ", sphere ")
    alt_text = f"{text(what)}: both cameras, detected outline overlaid"
    image = f'<img src="/picture/{text(name)}" alt="{alt_text}" loading="lazy">'
    return tag("figure", image + tag("figcaption", text(what)))


def cuts(view: CaseView, figures: CaseFigures | None) -> str:
    """Three planes through each target; those of the current step are open."""
    if figures is None or not figures.cuts:
        return tag("p", "The plan has not been checked yet.", class_="dim")
    at_hand = (view.running or view.upcoming).partition(":")[2]
    names = {PurePath(name).stem.removeprefix(PLAN_PICTURE): name for name in figures.cuts}
    shown = at_hand if at_hand in names else next(iter(names))
    return "".join(_cut(way, name, is_open=way == shown) for way, name in names.items())


def cuts_key(view: CaseView) -> object:
    """The part of the view that they depend on."""
    return (view.running or view.upcoming).partition(":")[2]


def _cut(way: str, name: str, *, is_open: bool) -> str:
    alt_text = f"Trajectory {text(way)} in three planes through its target"
    image = f'<img src="/picture/{text(name)}" alt="{alt_text}" loading="lazy">'
    return f"<details{' open' if is_open else ''}>{tag('summary', text(way))}{image}</details>"


def course(figures: CaseFigures | None) -> str:
    """Where theatre time was spent, as in the report."""
    if figures is None or not figures.course:
        return tag("p", "Shown for the latest state only.", class_="dim")
    return tag("div", figures.course, class_="paper")
