"""The predicted error at each target with its budget, before it is needed, and the two-way table."""

from __future__ import annotations

from console.panels.html import evidence_table, tag, text
from procedures.reporting.case_figures import CaseFigures

NOTE = "The residual of the fit (FRE) is not the accuracy; it only shows whether the fit is consistent."


def accuracy(figures: CaseFigures | None) -> str:
    """The tables of the valid registrations."""
    if figures is None or not figures.predictions:
        return tag("p", "No registration yet.", class_="dim")
    rows = "".join(
        tag(
            "tr",
            tag("th", text(one.target), scope="row")
            + tag("td", f"{one.rms_mm:.2f}", class_="num big")
            + tag("td", f"{one.limit_mm:.2f} at {one.confidence:.0%}", class_="num")
            + tag("td", f"{one.margin_mm:g}", class_="num"),
        )
        for one in figures.predictions
    )
    head = tag(
        "tr", "".join(tag("th", one, scope="col") for one in ("target", "mm rms", "limit mm", "margin mm"))
    )
    total = tag(
        "table",
        f"<caption>Predicted error at the targets</caption><thead>{head}</thead><tbody>{rows}</tbody>",
    )
    return total + "".join(map(evidence_table, figures.tables)) + tag("p", NOTE, class_="dim")
