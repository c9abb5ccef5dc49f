"""Assessment of a draft, and its HTML: errors, reach, clearance, and the expected error at each target.

A draft is judged twice: immediately without clearance, and then like `ronna-plan check`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from console.panels.html import table, tag, text
from console.planning.draft import Draft
from procedures.imaging.volume import Volume
from procedures.operator.margin import MarginVerdict, judge_error
from procedures.planning.errors import NotReachable, PlanMistakes
from procedures.planning.fiducial_choice import OTHERS_MM, expect_with_skin
from procedures.planning.guide import place_guides
from procedures.planning.head_in_ct import skull_angle_rad
from procedures.planning.paths import check_paths
from procedures.planning.plan_check import PlanCheck, check_plan
from procedures.planning.plan_file import parse_plan
from procedures.planning.plan_model import MOST_INSTRUMENT_MM, Plan
from procedures.planning.pose_name import name_body
from procedures.planning.structures import StructureDistance, measure_distances
from procedures.planning.target_error import predict_by_markers, predict_with_arm
from procedures.planning.theatre_arm import TheatreArm
from procedures.planning.visits import PathCheck, Unmet
from procedures.registration.error_theory import DEFAULT_CONFIDENCE
from procedures.registration.points import FEWEST_PAIRS
from procedures.registration.surface.surface import Surface
from procedures.registration.target_prediction import TargetPrediction
from ronna_hw.errors import RonnaError

SHARES_SHOWN = 6
COMMAND = re.compile(r"ronna-|(?<!\S)--[a-z]")  # a command, or an option of one


@dataclass(frozen=True)
class ExpectedAtTarget:
    """Expected error at one target. Its components add up in quadrature to `rms_mm`."""

    rms_mm: float
    limit_mm: float  # contains it with `DEFAULT_CONFIDENCE`
    shares_mm: tuple[tuple[str, float], ...]
    with_arm: bool  # otherwise from the markers alone
    by_skin: bool = False  # scanned, as skin usually moves; arm and guide are as usual then


@dataclass(frozen=True)
class Judgement:
    """Assessment of a draft. `thorough` includes the clearance, as in `ronna-plan check`."""

    draft: Draft
    thorough: bool = False
    findings: tuple[RonnaError, ...] = ()
    warnings: tuple[str, ...] = ()
    expected: dict[str, ExpectedAtTarget] = field(default_factory=dict)
    reached: tuple[str, ...] = ()  # in words, by the arm
    angles_deg: dict[str, float | None] = field(default_factory=dict)  # to the skull; 90 is perpendicular
    distances: tuple[StructureDistance, ...] = ()
    unmet: tuple[Unmet, ...] = ()  # poses that the arm does not reach
    is_arm_known: bool = False
    is_reach_known: bool = False  # its poses were tried
    complete: bool = False  # at least one trajectory has both ends, so there is something to judge


def judge(
    draft: Draft, volume: Volume, theatre: TheatreArm | None, *, thorough: bool, skin: Surface | None = None
) -> Judgement:
    """Assess the complete trajectories. Problems in the draft become findings, never exceptions.

    `skin` is that of the volume, for a draft that registers on it.
    """
    judged = Judgement(draft, thorough=thorough or theatre is None, is_arm_known=theatre is not None)
    if not any(item.ends for item in draft.ways):
        return judged
    judged = replace(judged, complete=True)
    missing: tuple[RonnaError, ...] = ()
    if draft.instrument_length_mm is None:  # everything else can be judged with any length
        missing = (
            PlanMistakes("the instrument length is missing", action="Enter it as printed on the packaging."),
        )
        draft = replace(draft, instrument_length_mm=MOST_INSTRUMENT_MM)
    try:
        plan = parse_plan(draft.content(volume.series_instance_uid))
    except RonnaError as mistake:
        return replace(judged, findings=(*missing, mistake))
    angles_rad = {item.id: skull_angle_rad(volume, item.trajectory) for item in plan.trajectories}
    judged = replace(
        judged,
        angles_deg={
            name: None if angle_rad is None else math.degrees(angle_rad)
            for name, angle_rad in angles_rad.items()
        },
        distances=measure_distances(plan),
    )
    markers_mm = np.array([item.centre_mm for item in draft.markers]).reshape(-1, 3)
    check, paths = _check_draft(plan, volume, markers_mm, theatre, thorough)
    unmet = check.unmet if thorough or paths is None else paths.unmet
    return replace(
        judged,
        findings=(*missing, *check.findings),
        warnings=check.warnings,
        unmet=unmet,
        is_reach_known=bool(unmet) or paths is not None,
        expected=_predict_errors(plan, draft, theatre, paths)
        if skin is None
        else _expect_by_skin(plan, markers_mm, skin),
        reached=_describe_reach(check),
    )


def _check_draft(
    plan: Plan, volume: Volume, markers_mm: NDArray[np.float64], theatre: TheatreArm | None, thorough: bool
) -> tuple[PlanCheck, PathCheck | None]:
    has_enough_markers = len(markers_mm) >= FEWEST_PAIRS
    if theatre is None:
        return check_plan(plan, volume, fiducials_mm=markers_mm), None
    if not thorough:
        check = check_plan(plan, volume, fiducials_mm=markers_mm, bore=theatre.bore)
        if check.findings or not has_enough_markers:
            return check, None
        return check, check_paths(theatre.arm, place_guides(plan, theatre.bore), markers_mm)
    spheres = tuple((float(x), float(y), float(z)) for x, y, z in markers_mm)
    check = check_plan(
        plan,
        volume,
        fiducials_mm=markers_mm,
        to_fiducials=has_enough_markers,
        arm=theatre.with_scene(volume, plan.fiducials, spheres),
        sight=theatre.sight,
        bore=theatre.bore,
    )
    return check, check.paths


def _expect_by_skin(
    plan: Plan, markers_mm: NDArray[np.float64], skin: Surface
) -> dict[str, ExpectedAtTarget]:
    found = expect_with_skin(skin, markers_mm, plan)
    others = ("arm, guide and instrument, as usual", OTHERS_MM)
    return {
        one.target: ExpectedAtTarget(
            one.total_mm,
            one.total_limit_mm,
            ((found.words, one.rms_mm), others),
            with_arm=True,
            by_skin=True,
        )
        for one in found.expected
    }


def _predict_errors(
    plan: Plan,
    draft: Draft,
    theatre: TheatreArm | None,
    paths: PathCheck | None,
) -> dict[str, ExpectedAtTarget]:
    if len(draft.markers) < FEWEST_PAIRS:
        return {}
    markers_mm = np.array([item.centre_mm for item in draft.markers])
    covariances_mm2 = np.array([item.covariance_mm2 for item in draft.markers])
    found = {}
    for item in plan.trajectories:
        try:
            if theatre is not None and paths is not None and paths.passed:
                predicted = predict_with_arm(
                    theatre, plan, covariances_mm2, paths, item.id, draft.deformation
                )
                found[item.id] = _to_expected_error(predicted, with_arm=True)
            else:
                predicted = predict_by_markers(
                    markers_mm, covariances_mm2, item.target_mm, draft.deformation, item.fusion_error_mm
                )
                found[item.id] = _to_expected_error(predicted, with_arm=False)
        except (RonnaError, np.linalg.LinAlgError):  # collinear markers; the check reports it
            continue
    return found


def _to_expected_error(predicted: TargetPrediction, *, with_arm: bool) -> ExpectedAtTarget:
    shares = sorted(predicted.budget_mm.items(), key=lambda item: -item[1])
    return ExpectedAtTarget(predicted.rms_mm, predicted.limit_mm(), tuple(shares), with_arm)


def _describe_reach(check: PlanCheck) -> tuple[str, ...]:
    if check.paths is None:
        return ()
    lines = [f"all {len(check.paths.reached)} poses are reached in one posture of the arm"]
    closest = [item.preview.closest for item in check.motions if item.preview.closest is not None]
    if closest:
        least = min(closest, key=lambda item: item.distance_mm)
        pair = f"{name_body(least.first)}, {name_body(least.second)}"
        lines.append(f"every motion is clear; smallest distance {least.distance_mm:.0f} mm ({pair})")
    lines += [
        f"at {name} the guide is turned by {math.degrees(turn):+.0f}° about its axis"
        for name, turn in check.turns_rad
        if turn
    ]
    return tuple(lines)


def verdict(judged: Judgement, draft: Draft) -> str:
    """Show the assessment of the draft, or the previous one marked as outdated until it is available."""
    parts = [
        tag(
            "li",
            f"{text(f'{item.code} {item.summary}')} {tag('span', text(page_advice(item)), class_='advice')}",
            class_="bad",
        )
        for item in judged.findings
        if not isinstance(item, NotReachable)
    ]
    if any(isinstance(item, NotReachable) for item in judged.findings):
        parts.append(
            tag("li", f"{NotReachable.code} the arm does not reach everything: see Reach.", class_="bad")
        )
    parts += [tag("li", text(item), class_="warn") for item in judged.warnings]
    parts += [tag("li", text(_skull_text(name, angle))) for name, angle in judged.angles_deg.items()]
    current = judged.draft is draft
    head = _outcome_html(judged) if current else tag("p", "Checking…", class_="dim")
    more = mark_outdated(tag("ul", "".join(parts), class_="findings"), judged, draft) if parts else ""
    state = "judged" if current and judged.thorough else "judging"
    return tag("div", head + more, data_state=state, data_findings=str(len(judged.findings)))


def expected(judged: Judgement, draft: Draft) -> str:
    if not judged.expected:
        words = "Needs three markers and a complete trajectory." if not judged.complete else "Not available."
        return tag("p", words, class_="dim")
    rows = "".join(
        _target_html(item.identifier, judged.expected[item.identifier], item.margin_mm)
        for item in judged.draft.ways
        if item.identifier in judged.expected
    )
    return mark_outdated(rows + tag("p", _basis_text(judged.expected.values()), class_="dim"), judged, draft)


def page_advice(problem: RonnaError) -> str:
    """Return what to do about a problem at a page; what needs a command is for whoever set up the planner."""
    if problem.page_advice and not COMMAND.search(problem.page_advice):
        return problem.page_advice
    return f"Ask whoever set up this planner: the list of errors says what to do about {problem.code}."


def mark_outdated(content: str, judged: Judgement, draft: Draft) -> str:
    """Mark findings as outdated, greyed out and with a note, once their draft has changed."""
    if judged.draft is draft or not content:
        return content
    return tag("div", content + tag("p", "Before the last change; being checked again."), class_="stale")


def _outcome_html(judged: Judgement) -> str:
    if not judged.complete:
        return tag("p", "Set entry and target of a trajectory.", class_="dim")
    if judged.findings:
        return tag("p", "This plan would be refused:", class_="bad")
    if judged.is_arm_known and not judged.thorough:
        return tag("p", "Checking clearance…", class_="dim")
    words = "This plan would be accepted."
    if not judged.is_arm_known:
        words += " The arm's reach is not checked: see Reach."
    return tag("p", words, class_="ok")


def _skull_text(name: str, angle_deg: float | None) -> str:
    if angle_deg is None:
        return f"{name} crosses no bone in the CT"
    return f"{name} meets the skull at {angle_deg:.0f}° (90° is perpendicular)"


def _target_html(name: str, item: ExpectedAtTarget, margin_mm: float) -> str:
    errors = f"{item.rms_mm:.2f} mm rms, {item.limit_mm:.2f} mm at {DEFAULT_CONFIDENCE:.0%}"
    words, shown_as = f"{name}, markers only: {errors}", "big"
    if item.with_arm:  # a part of the chain is not judged against a margin for the whole
        judged = judge_error(margin_mm, item.rms_mm, item.limit_mm)
        words = f"{name}: {errors}; margin {margin_mm:g} mm: {judged}"
        shown_as = "big" if judged is MarginVerdict.PREDICTED_WITHIN else judged.colour
    line = tag("p", text(words), class_=shown_as, data_expected=name, data_rms=f"{item.rms_mm:.4f}")
    rows = [(source, f"{rms:.3f}") for source, rms in item.shares_mm[:SHARES_SHOWN]]
    return line + table(("source", "rms mm"), rows)


def _basis_text(expected: Iterable[ExpectedAtTarget]) -> str:
    found = tuple(expected)
    if any(item.by_skin for item in found):
        return "For skin that moves as it usually does: how it has moved, the scan in the case tells."
    if all(item.with_arm for item in found):
        return (
            "Includes the arm at the poses found; "
            "excludes the stereo measurement, which is made during the case."
        )
    return (
        "Markers only: without the errors of arm, guide and instrument there is no verdict on the margin. "
        "They are added where Reach finds every pose within reach."
    )
