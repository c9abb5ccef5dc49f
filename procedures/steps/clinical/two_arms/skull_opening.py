"""Judgement of an opening that the assistant has drilled: what the force says of it against the CT.

Where they do not agree it counts only once the operator has accepted it; without bone felt, not at all.
"""

from __future__ import annotations

from procedures.engine.context import StepContext
from procedures.journal.errors import GateFailed
from procedures.operator.question import NO, YES, Question, Topic
from procedures.steps.clinical.results import CranialOpening, FeedEnd
from ronna_hw.devices.contact import Drilled
from ronna_hw.text import format_against_limit

# A breakthrough elsewhere about the inside of the skull by the CT is for the operator. The point of a drill
# passes the inside by up to a mm until the force falls.
# Safety against a breakthrough taken for one (U).
EARLY_MM, LATE_MM = 1.0, 2.0
TOUCH_N = 4.0  # skin at its edges and a drill that turns in air take less (U)


def describe_opening(opening: CranialOpening) -> str:
    """Describe an opening in one line."""
    inside = f"{opening.planned_inside_mm:.1f}"
    if opening.further_inside_mm is not None:
        inside += f" or {opening.further_inside_mm:.1f}"
    judged = "accepted by the operator" if opening.accepted else "not accepted by the operator"
    return (
        f"{_describe_end(opening)} {opening.depth_mm:.1f} mm behind the entry (inside of the skull by the CT "
        f"{inside} mm), up to {opening.peak_force_N:.1f} ± "
        f"{opening.force_error_N:.1f} N of {opening.force_limit_N:g} N, {opening.side_force_N:.1f} N across, "
        f"{opening.drilled_s:.0f} s"
        + (f", slowed for {opening.slowed_s:.0f} s" if opening.slowed_s >= 1.0 else "")
        + (f"; {opening.doubt}, {judged}" if opening.doubt else "")
    )


def _describe_end(opening: CranialOpening) -> str:
    if not opening.force_fell and opening.end is not FeedEnd.ENDED:
        return "begun, to"
    if opening.broke_through:
        return "by the force it was through at"
    return "the force fell at" if opening.force_fell else "no breakthrough was seen up to"


def add_feed(before: CranialOpening, fed: Drilled, depth_mm: float, end: FeedEnd) -> CranialOpening:
    """Return an opening after another feed, which took the tip to a depth; nobody has accepted it yet."""
    resisted_mm = [] if before.resisted_mm is None else [before.resisted_mm]
    if fed.met_bone:
        resisted_mm.append(depth_mm - fed.free_mm)
    further_mm = before.further_inside_mm
    goes_on = further_mm is not None and depth_mm < further_mm - EARLY_MM
    changed = {
        "end": end,
        "depth_mm": max(depth_mm, before.depth_mm),
        "resisted_mm": max(resisted_mm, default=None),
        "force_fell": fed.broke_through,
        "broke_through": fed.broke_through and not goes_on,
        "met_bone": fed.met_bone or (end is FeedEnd.INTERRUPTED and before.met_bone),
        "accepted": False,
        "peak_force_N": fed.peak_force_N,
        "side_force_N": fed.side_force_N,
        "drilled_s": fed.drilled_s,
        "slowed_s": fed.slowed_s,
        "forces_N": fed.forces_N,
    }
    return before.model_copy(update=changed)


def require_bone(context: StepContext, opening: CranialOpening, begun_mm: float | None) -> None:
    """Raise PRO-007 if no bone was felt where it should have been: the force on the drill says nothing."""
    if opening.met_bone:
        return
    got = f"at most {opening.peak_force_N:.1f} N up to {opening.depth_mm:.1f} mm"
    if begun_mm is not None:
        raise GateFailed(
            f"at {context.trajectory} the drill felt no bone below an opening begun earlier",
            expected=f"bone that resists behind its bottom, {begun_mm:.1f} mm behind the entry",
            got=got,
            action="The drill is switched off, and nothing moves. The opening may be through already, or the "
            "force sensor dead. Repeated, the step leaves the rest to a hand. Send the arms home: the "
            "drill is led out once that is confirmed. Then look into the opening, and go on by hand.",
        )
    raise GateFailed(
        f"at {context.trajectory} the drill felt no bone",
        expected=f"{TOUCH_N:g} N behind the outside of the skull, {opening.planned_outside_mm:.1f} mm behind "
        "the entry",
        got=got,
        action="The drill is switched off, and nothing moves. The force sensor may have a wrong scale or a "
        "dead axis: the drill may be in bone all the same. Send the arms home: the drill is led out once "
        "that is confirmed. Then drill by hand, and have the sensor checked first.",
    )


def find_doubt(opening: CranialOpening) -> tuple[str, str]:
    """Return what of an opening does not agree with the CT, and the limit that it misses, '' if nothing."""
    depth_mm, inside_mm = opening.depth_mm, opening.planned_inside_mm
    off_mm, further_mm = depth_mm - inside_mm, opening.further_inside_mm
    if not opening.force_fell and opening.end is not FeedEnd.ENDED:
        return _describe_interruption(opening), "a feed that ended"
    if not opening.force_fell:
        further = (
            "" if further_mm is None else f", where by another reading it goes on to {further_mm:.1f} mm"
        )
        doubt = (
            f"no breakthrough up to {depth_mm:.1f} mm, {off_mm:.1f} mm behind the skull of the CT{further}"
        )
        return doubt, "a fall of the force"
    if further_mm is not None and not opening.broke_through:
        doubt = (
            f"the force fell at {depth_mm:.1f} mm, where the CT has two readings: the inside of the skull at "
            f"{inside_mm:.1f} mm, or bone up to {further_mm:.1f} mm, of which {further_mm - depth_mm:.1f} mm "
            "are left"
        )
        return doubt, f"{EARLY_MM:g} mm before {further_mm:.1f} mm"
    if off_mm < -EARLY_MM:
        doubt = f"a breakthrough {-off_mm:.1f} mm before the inside of the skull by the CT"
        return doubt, f"{EARLY_MM:g} mm before {inside_mm:.1f} mm"
    if off_mm > LATE_MM:
        doubt = f"a breakthrough {off_mm:.1f} mm behind the inside of the skull by the CT"
        return doubt, f"{LATE_MM:g} mm behind {inside_mm:.1f} mm"
    return "", ""


def _describe_interruption(opening: CranialOpening) -> str:
    if opening.end is FeedEnd.UNKNOWN:
        return "a feed whose end is not recorded"
    if opening.resisted_mm is None:
        return f"a feed interrupted at {opening.depth_mm:.1f} mm, without bone"
    return (
        f"a feed interrupted at {opening.depth_mm:.1f} mm, with bone that resisted up to "
        f"{opening.resisted_mm:.1f} mm"
    )


def accept_opening(context: StepContext, opening: CranialOpening, before: str = "") -> CranialOpening:
    """Return an opening as accepted: where it does not agree with the CT, by the operator.

    `before` tells of one that was drilled earlier. Raises PRO-007 if the operator does not accept it.
    """
    trajectory = context.trajectory
    doubt, limit = find_doubt(opening)
    if doubt:
        context.find(f"at {trajectory} the drill found {doubt}{before}")
        _ask_to_accept(context, opening, f"{doubt}{before}", limit)
    accepted = opening.model_copy(update={"accepted": True})
    if accepted != opening:
        stages = context.workcell.master.instrument.stages
        stages.record_opening(trajectory, accepted.model_dump(mode="json"))
    context.find(f"at {trajectory} the assistant drilled: {describe_opening(accepted)}{before}")
    return accepted


def _ask_to_accept(context: StepContext, opening: CranialOpening, doubt: str, limit: str) -> None:
    """Ask whether an opening counts as drilled. Raises PRO-007 if it does not."""
    trajectory, depth_mm = context.trajectory, opening.depth_mm
    further = (
        "it asks again, and drills no further"
        if opening.force_fell
        else "where bone resisted to the end it asks before it goes in again, else a hand drills"
    )
    question = Question(
        Topic.BREAKTHROUGH,
        f"Does the opening at {trajectory} count as drilled? The drill is switched off.",
        f"{doubt}; {YES}: you are asked once more whether the skull is drilled; {NO}: the step ends, and a "
        f"drill in the guide stays there; repeated, it leads that out; {further}",
        (YES, NO),
        trajectory=trajectory,
        timeout_s=None,
    )
    if context.choose(question) == YES:
        return
    rest = (
        "The assistant drills no further there, whichever step is repeated: look into the opening, have the "
        "rest drilled by hand, and repeat the step to have it counted."
        if opening.force_fell
        else "Drilling goes on only after another question. Or send the arms home and drill by hand."
    )
    raise GateFailed(
        f"the operator did not accept the opening at {trajectory}",
        limit=limit,
        got=f"{format_against_limit(depth_mm, opening.planned_inside_mm, 1)} mm: {doubt}",
        action="Nothing moves. Repeat the step: a drill in the guide is led out once that is confirmed. "
        + rest,
    )
