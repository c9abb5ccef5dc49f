"""Content of the open question: what decides it in large type, pictures beside it, the evidence folded."""

from __future__ import annotations

from html import escape
from pathlib import PurePath

from console.panels.ct_planes import ct_planes
from console.panels.html import evidence_table, tag, text
from procedures.engine.events import Questioned
from procedures.imaging.trajectory_cuts import PLAN_PICTURE
from procedures.operator.question import Picture, PredictedError
from procedures.reporting.sections.surface import SURFACE_PICTURES, caption_of_skin

NOT_KEPT = "Name and identifier were shown to the operator; no record keeps them."


def question_heading(question: Questioned) -> str:
    return tag("h2", text(question.subject), data_question=str(question.question))


def question_words(question: Questioned) -> str:
    """Show what decides the question, and its statements."""
    return (
        "".join(map(_render_decision, question.predicted[:1]))
        + _render_identity(question)
        + _render_value(question)
    )


def question_pictures(question: Questioned) -> str:
    """Show the pictures of a question, all but the first folded."""
    return "".join(_render_picture(one, is_first=not place) for place, one in enumerate(question.pictures))


def question_evidence(question: Questioned) -> str:
    return "".join(
        tag("details", tag("summary", text(one.title)) + evidence_table(one), class_="evidence")
        for one in question.evidence
    )


def _render_decision(predicted: PredictedError) -> str:
    widened = ", widened" if predicted.caution else ""
    figures = (
        (f"{predicted.rms_mm:.2f} mm", f"predicted error at {predicted.target} (rms)"),
        (f"{predicted.limit_mm:.2f} mm", f"limit of {predicted.confidence:.0%} of such errors{widened}"),
        (f"{predicted.margin_mm:g} mm", "the plan's margin"),
    )
    shown = "".join(
        tag("div", tag("dt", text(what)) + tag("dd", text(figure), class_="num")) for figure, what in figures
    )
    kind = predicted.verdict.colour
    sign = {"ok": "✓", "warn": "!", "bad": "✗"}[kind]
    return tag("dl", shown, class_="decides") + tag("p", f"{sign} {text(predicted.sentence)}", class_=kind)


def _render_identity(question: Questioned) -> str:
    if not question.identity_sha256:
        return ""
    if question.identity is None:
        return tag("p", NOT_KEPT, class_="dim")
    rows = (
        tag("div", tag("dt", text(name)) + tag("dd", text(said))) for name, said in question.identity.rows
    )
    return tag("dl", "".join(rows), class_="identity")


def _render_value(question: Questioned) -> str:
    """Show the value as a list of its lines, with the part to read back in bold."""
    lines = [text(line) for line in question.value.splitlines()]
    if shown := text(question.emphasis):
        places = [place for place, line in enumerate(lines) if shown in line][:1]
        for place in places:
            lines[place] = lines[place].replace(shown, tag("strong", shown), 1)
    shown_as = "value dim" if question.predicted else "value"  # what is predicted stands above, in large type
    if len(lines) < 2:
        return tag("p", "".join(lines), class_=shown_as)
    return tag("ul", "".join(tag("li", line) for line in lines), class_=shown_as)


def _render_picture(picture: Picture, *, is_first: bool) -> str:
    """Show a picture, addressed by its digest: the server serves no other content there.

    The stem of its name may end in a number, if the plan was checked again.
    """
    name = PurePath(picture.name)
    address = f"/picture/{escape(name.name)}?shown={escape(picture.sha256)}"
    if name.name.startswith(SURFACE_PICTURES):
        caption = text(caption_of_skin(name.name))
        shown = f'<img class="whole" src="{address}" alt="{caption}">'
    else:
        caption = text(f"{picture.trajectory or name.stem.removeprefix(PLAN_PICTURE)} in the CT")
        shown = ct_planes(address, caption)
    link = f'<a href="{address}" target="_blank" rel="noopener" aria-label="{caption}, enlarged">{shown}</a>'
    return f"<details{' open' if is_first else ''}>{tag('summary', caption)}{link}</details>"
