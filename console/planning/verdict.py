"""Assessment of the draft, as HTML: mistakes, reach and clearance, and the expected error."""

from __future__ import annotations

from collections.abc import Iterable

from console.panels.html import table, tag, text
from console.planning.draft import Draft
from console.planning.judging import Expected, Judged

SHARES_SHOWN = 6


def verdict(judged: Judged, draft: Draft) -> str:
    """Assessment of the current draft or, until it is checked, of the previous one."""
    late = judged.draft is not draft or not judged.thorough
    head = _outcome(judged)
    parts = [tag("p", head, class_="judging") if late else head]
    parts += [
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
    more = tag("ul", "".join(parts[1:]), class_="findings") if parts[1:] else ""
    state = "judging" if late else "judged"
    return tag("div", parts[0] + more, data_state=state, data_findings=str(len(judged.findings)))


def expected(judged: Judged, draft: Draft) -> str:
    """Expected error at each target, with its margin."""
    if not judged.expected:
        words = "Needs three markers and a complete trajectory." if not judged.complete else "Not available."
        return tag("p", words, class_="dim")
    rows = "".join(
        _target(one.identifier, judged.expected[one.identifier], one.margin_mm)
        for one in draft.ways
        if one.identifier in judged.expected
    )
    return rows + tag("p", _basis(judged.expected.values()), class_="dim")


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
