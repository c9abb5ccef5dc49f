"""The stereo pairs that were measured, with the outlines that were found in them, newest first."""

from __future__ import annotations

from pathlib import PurePath

from console.panels.html import tag, text
from procedures.reporting.case_figures import CaseFigures

MOST = 4


def pictures(figures: CaseFigures | None) -> str:
    """The last of them."""
    names = figures.pictures[-MOST:][::-1] if figures else ()
    if not names:
        return tag("p", "No stereo picture yet.", class_="dim")
    return tag("div", "".join(map(_picture, names)), class_="pictures")


def _picture(name: str) -> str:
    what = PurePath(name).stem.removeprefix("stereo-").replace("-", ", sphere ")
    told = f"{text(what)}: both cameras, with the outline found"
    image = f'<img src="/picture/{text(name)}" alt="{told}" loading="lazy">'
    return tag("figure", image + tag("figcaption", text(what)))
