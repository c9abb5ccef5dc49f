"""Assessment of the draft, as HTML: mistakes, reach and clearance, and the expected error."""

from __future__ import annotations

from collections.abc import Iterable

from console.panels.html import table, tag, text
from console.planning.draft import Draft
from console.planning.judging import Expected, Judged

SHARES_SHOWN = 6


def verdict(judged: Judged, draft: Draft) -> str:
    """Assessment of the current draft; until it is checked, the details of the previous one, marked so."""
    parts = [
        tag(
            "li",
            f"{text(f'{one.code} {one.summary}')} {tag('span', text(one.advice), class_='advice')}",
            class_="bad",
        )
        for one in judged.findings
    ]
    parts += [tag("li", text(one), class_="warn") for one in judged.warnings]
    parts += [tag("li", text(_to_skull(name, angle))) for name, angle in judged.angles_deg.items()]
    parts += [tag("li", text(one), class_="ok") for one in judged.reached]
    current = judged.draft is draft
    head = _outcome(judged) if current else tag("p", "Checking…", class_="dim")
    more = marked(tag("ul", "".join(parts), class_="findings"), judged, draft) if parts else ""
    state = "judged" if current and judged.thorough else "judging"
    return tag("div", head + more, data_state=state, data_findings=str(len(judged.findings)))


def expected(judged: Judged, draft: Draft) -> str:
    """Expected error at each target, with its margin."""
    if not judged.expected:
        words = "Needs three markers and a complete trajectory." if not judged.complete else "Not available."
        return tag("p", words, class_="dim")
    rows = "".join(
        _target(one.identifier, judged.expected[one.identifier], one.margin_mm)
        for one in judged.draft.ways
        if one.identifier in judged.expected
    )
    return marked(rows + tag("p", _basis(judged.expected.values()), class_="dim"), judged, draft)


def marked(content: str, judged: Judged, draft: Draft) -> str:
    """What was found for a draft; grey, and so in words, once that is not the current one."""
    if judged.draft is draft or not content:
        return content
    return tag("div", content + tag("p", "Before the last change; being checked again."), class_="stale")


def _outcome(judged: Judged) -> str:
    if not judged.complete:
        return tag("p", "Set entry and target of a trajectory.", class_="dim")
    if judged.findings:
        return tag("p", "This plan would be refused:", class_="bad")
    if judged.arm_known and not judged.thorough:
        return tag("p", "Checking clearance…", class_="dim")
    words = "This plan would be accepted."
    if not judged.arm_known:
        words += " No arm given: open with --config and --robot-from-ct to check reach and clearance."
    return tag("p", words, class_="ok")


def _to_skull(name: str, angle_deg: float | None) -> str:
    if angle_deg is None:
        return f"{name} crosses no bone in the CT"
    return f"{name} meets the skull at {angle_deg:.0f}° (90° is perpendicular)"


def _target(name: str, one: Expected, margin_mm: float) -> str:
    beyond = one.rms_mm > margin_mm
    words = f"{name}: {one.rms_mm:.2f} mm rms, {one.limit_mm:.2f} mm at 95 %; margin {margin_mm:g} mm"
    line = tag(
        "p",
        text(words + (" — exceeds the margin" if beyond else "")),
        class_="bad" if beyond else "big",
        data_expected=name,
        data_rms=f"{one.rms_mm:.4f}",
    )
    rows = [(source, f"{rms:.3f}") for source, rms in one.shares_mm[:SHARES_SHOWN]]
    return line + table(("source", "rms mm"), rows)


def _basis(expected: Iterable[Expected]) -> str:
    if all(one.with_arm for one in expected):
        return (
            "Includes the arm at the poses found; "
            "excludes the stereo measurement, which is made during the case."
        )
    return "From the markers alone; the arm's own errors are not included."
