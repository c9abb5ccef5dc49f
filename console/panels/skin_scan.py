"""Panel of a scan of the skin: where it has come, and how the error falls that is expected of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from console.panels.html import head_row, table, table_of, tag, text
from procedures.engine.events import ExpectedError, ScanProgress
from procedures.imaging.drawn_skin import MISSING, SCANNED, DrawnSkin
from procedures.reporting.sections.surface import COVERAGE_CAPTION

NO_MARGINS: Mapping[str, float] = {}
COVERED_PX, MISSING_PX = "7", "4"  # of a place, in the picture's pixels: colour alone does not tell


def skin_scan(
    scan: ScanProgress | None, skin: DrawnSkin | None, margins_mm: Mapping[str, float] = NO_MARGINS
) -> str:
    """Show a scan, under way or whole, on the skin if that is known; nothing without a scan.

    `margins_mm` are those of the plan, by target.
    """
    if scan is None:
        return ""
    rows = (f"{scan.looks_done} of {scan.looks_planned}", f"{scan.covered_share:.0%}")
    errors = "".join(
        tag(
            "tr",
            tag("th", text(one.target), scope="row")
            + tag("td", _tell_expected(one.rms_mm), class_="num big")
            + tag("td", f"{margins_mm[one.target]:g}" if one.target in margins_mm else "-", class_="num")
            + tag("td", _draw_fall(one.rms_mm, scan.looks_planned)),
        )
        for one in scan.expected or (ExpectedError(target="all", rms_mm=(scan.predicted_error_mm,)),)
    )
    head = head_row("target", "mm rms", "margin mm", "look by look")
    caption = "Expected error at the targets, without arm and guide"
    picture = "" if skin is None else _draw_scan(scan, skin)
    return picture + table(("looks taken", "planned skin covered"), (rows,)) + table_of(head, errors, caption)


def _draw_scan(scan: ScanProgress, skin: DrawnSkin) -> str:
    """Draw the covered and the missing places over the picture of the skin."""
    width, height = skin.size_px
    marks = "".join(
        tag(
            "path",
            "",
            d="".join(f"M{x} {y}h0" for x, y in skin.place(np.array(places_mm))),
            stroke=f"rgb({red:g},{green:g},{blue:g})",
            stroke_width=width_px,
        )
        for places_mm, (blue, green, red), width_px in (
            (scan.missing_mm, MISSING, MISSING_PX),
            (scan.covered_mm, SCANNED, COVERED_PX),
        )
        if places_mm
    )
    image = tag(
        "img", "", src="/picture/skin.png", alt="Skin from the right side, the front and the left side"
    )
    drawing = tag("svg", marks, viewBox=f"0 0 {width} {height}", aria_hidden="true")
    return tag("figure", image + drawing + tag("figcaption", text(COVERAGE_CAPTION)), class_="scanned")


def _tell_expected(rms_mm: Sequence[float | None]) -> str:
    latest = rms_mm[-1] if rms_mm else None
    return "too little scanned" if latest is None else f"{latest:.2f}"


def _draw_fall(rms_mm: Sequence[float | None], looks: int) -> str:
    """Draw an error after each look as SVG, from none at the bottom to its largest at the top."""
    known = [(look, error) for look, error in enumerate(rms_mm, start=1) if error is not None]
    if not known:
        return ""
    largest = max(error for _, error in known) or 1.0
    points = [f"{look / max(looks, look):.3f},{1.0 - error / largest:.3f}" for look, error in known]
    line = tag("polyline", "", points=" ".join([*points[:1], *points]))  # a single one is a dot
    words = f"from {known[0][1]:.2f} to {known[-1][1]:.2f}"
    return tag(
        "svg",
        line,
        class_="fall",
        viewBox="0 0 1 1",
        preserveAspectRatio="none",
        role="img",
        aria_label=words,
    )
