"""A tool in the assistant's holder, brought over the guide that the master holds, coaxial with its bore.

Nothing enters the bore before joints and tracker agree that the tool is on its axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from procedures.engine.context import StepContext
from procedures.guards.assistant_on_axis import BETTER_FRAMES, LARGEST_OFF_MM, BesideBore, beside_bore
from procedures.guards.errors import PatientUnseen
from procedures.guards.guide_displacement import PUSHED_MM, GuideAtRest
from procedures.guards.room_reading import AS_KNOWN, CAREFUL_FRAMES, ArrivedSides
from procedures.guards.room_watch import JudgedReading
from procedures.journal.errors import GateFailed
from procedures.operator.question import YES, Topic
from procedures.planning.errors import NotReachable
from procedures.room.sighting import Tracked
from procedures.steps.branches import KEPT_BASES
from procedures.steps.clinical.results import KnownBases
from procedures.steps.clinical.room import check_room, room_watch
from procedures.steps.clinical.two_arms.insertion_axis import (
    ABOVE_GUIDE_MM,
    Meeting,
    find_axis,
    registered_here,
    surround_at_guide,
)
from procedures.steps.clinical.two_arms.seen_on_axis import look_before_retreat
from procedures.steps.clinical.work_progress import DepthStop
from procedures.workcell import InsertionAxis
from procedures.workcell.arm_history import HeldDrill, HeldInstrument
from procedures.workcell.assistant import Assistant, GuidedStretch
from procedures.workcell.tracker_look import read_frames_at_rest
from ronna_hw.text import format_against_limit
from ronna_hw.vectors import joint_vector

# Safety against an instrument that enters the bore askew (U).
COAXIAL_MM, COAXIAL_RAD = 0.2, math.radians(0.2)

MOUTH_MM = 10.0  # of the bore, which the tip finds slowly
OFF_SKIN_MM = 10.0  # of the tip, where it goes on slowly: edges of the incision stand above the entry

LOADING_STEP_RAD = math.radians(30.0)
# Safety against a holder that meets the guide (U).
NEAR_BORE_MM = 60.0  # parts of the guide with an end this close to its axis may come close to the holder


class LoadedTool(NamedTuple):
    """Tool for the assistant's holder: its tip beyond the clamp, and how it gets there."""

    tip_mm: float
    drill: HeldDrill | None  # of one that is a drill
    load: Callable[[StepContext], None]
    ask: Callable[[InsertionAxis], str]  # whether the assistant may bring it over the guide, and lead it
    prepare: Callable[[StepContext], None] | None = None  # with the holder empty, and the arm at home


class OverGuide(NamedTuple):
    """Axis on which a tool rests over the guide, and how far it is beside it by joints and tracker."""

    axis: InsertionAxis
    off_axis_mm: float
    off_axis_rad: float
    seen: BesideBore | None


def bring_over_guide(context: StepContext, tool: LoadedTool) -> OverGuide:
    """Have the assistant bring a tool over the guide.

    Raises PRO-002, PRO-007, PLAN-007, DUAL-001 and, for a cart that was moved, as `check_room`.
    """
    workcell, assistant, trajectory = context.workcell, context.workcell.assistant, context.trajectory
    known = close_earlier_way(context)
    missed = [] if assistant.place.is_home else ["at home, where it was not"]  # of the looks at its frame
    missed += _missed(context, "with the assistant home")
    surround_at_guide(context, assistant.joints_rad(), registered_here(context))
    if tool.prepare is not None:
        tool.prepare(context)
    _present_holder(context, assistant, tool.tip_mm)
    missed += _missed(context, "with the holder empty")
    assistant.hold_instrument(HeldInstrument(trajectory, tool.tip_mm, _parts_at_bore(context), tool.drill))
    tool.load(context)
    axis, start_rad, via_rad = find_axis(context, assistant, tool.tip_mm, known)
    workcell.start()
    assistant.supervised.confirm(
        Topic.APPROACH,
        tool.ask(axis),
        [*map(assistant.go_motion, via_rad), assistant.settle_motion(start_rad, axis.arriving)],
        trajectory,
        covers=f"{axis.travel_mm:.0f} mm along the bore, which the distances below leave out",
    )
    missed += _missed(context, "with the holder loaded")
    context.progress(0.7, f"the assistant moves over the guide at {trajectory}")
    for joints_rad in via_rad:
        assistant.go(joints_rad)
    assistant.settle(start_rad, axis.arriving)
    off_axis_mm, off_axis_rad = _require_coaxial(context, assistant, axis, known)
    seen = _require_seen_coaxial(context, axis, missed)
    workcell.master.instrument.record_insertion(trajectory)
    return OverGuide(axis, off_axis_mm, off_axis_rad, seen)


def close_earlier_way(context: StepContext) -> KnownBases:
    """Have what an earlier way left in the guide led out and removed, the assistant home; return the bases.

    Raises PRO-002, PRO-007 and PRO-054.
    """
    workcell, assistant, trajectory = context.workcell, context.workcell.assistant, context.trajectory
    context.rest_drill()
    if assistant.place.is_on_axis:  # halted on its way earlier
        workcell.start()
        assistant.lead_out(look_back(context))
        context.find(f"at {trajectory} what the assistant held, halted on its way in, was led out first")
    context.request_instrument_removal()
    known = _require_bases(context)
    if assistant.place.is_out:  # stopped on its way earlier: a way in begins at home, so that one leads back
        surround_at_guide(context, assistant.joints_rad(), registered_here(context))
        workcell.start()
        assistant.return_home()
    return known


def look_back(context: StepContext) -> str:
    """Look whether a cart was displaced; returns as `look_before_retreat`. Raises PRO-054."""
    return look_before_retreat(context.workcell, room_watch(context))


def _present_holder(context: StepContext, assistant: Assistant, tip_mm: float) -> None:
    """Turn the flange where the arm itself is in the way of the instrument in its holder. Raises PLAN-007."""
    workcell, here_rad = context.workcell, assistant.joints_rad()
    steps = range(round(math.pi / LOADING_STEP_RAD) + 1)
    turns_rad = [side * step * LOADING_STEP_RAD for step in steps for side in (1, -1)]
    postures = [(*here_rad[:-1], here_rad[-1] + turn_rad) for turn_rad in turns_rad]
    clear = (one for one in map(joint_vector, postures) if assistant.rests_clear(one, tip_mm))
    loading_rad = next(clear, None)
    if loading_rad is None:
        raise NotReachable(
            f"no turn of the assistant's flange leaves room for the instrument at {context.trajectory}",
            action="Give the assistant another home, with room on the side of its clamp, and set up again.",
        )
    if loading_rad != here_rad:
        workcell.start()
        context.progress(0.68, "the assistant turns its clamp to where the instrument is put in")
        assistant.settle(loading_rad)


def _missed(context: StepContext, occasion: str) -> list[str]:
    """Look at the room before the assistant leaves; return the occasion if its frame is not seen."""
    judged = _look_at_assistant(context, f"{occasion}, before {context.trajectory}")
    return [] if Tracked.ASSISTANT in judged.look.frames else [occasion]


def _require_bases(context: StepContext) -> KnownBases:
    """Return the bases. Raises PRO-007 if they predate a fault of an arm and the operator rejects them."""
    known = context.result_among(KnownBases, lambda made: made[-1])
    assert known is not None
    if (fault := context.doubt(KnownBases)) is not None:
        question = KEPT_BASES.question(
            "Keep the bases of the two arms? Neither arm, load nor cart may have been touched.",
            f"they are older than a fault: {fault}",
            context.trajectory,
        )
        if context.choose(question) != YES:
            raise GateFailed(
                "the bases of the two arms are older than a fault of an arm",
                got=fault,
                action="Send the arms home, then localize again, starting with the tracker.",
            )
        context.keep(KnownBases)
    return known


def _require_coaxial(
    context: StepContext, assistant: Assistant, axis: InsertionAxis, known: KnownBases
) -> tuple[float, float]:
    """Return how far (mm, rad) the instrument is off the bore by the joints of both arms. Raises PRO-007."""
    meeting = Meeting.of(context, known)
    clamp = meeting.guide(context.workcell).inverse() @ meeting.clamp(assistant, axis.arriving)
    turned_rad = math.acos(min(1.0, float(clamp.rotation_matrix[2, 2])))
    bore = meeting.bore
    ends = [clamp.inverse().apply((0.0, 0.0, z)) for z in (-bore.reach_mm - bore.length_mm, -bore.reach_mm)]
    off_mm = max(math.hypot(end[0], end[1]) for end in ends)
    if off_mm > COAXIAL_MM or turned_rad > COAXIAL_RAD:
        raise GateFailed(
            f"the instrument is not coaxial with the guide at {context.trajectory}",
            limit=f"{COAXIAL_MM:g} mm, {math.degrees(COAXIAL_RAD):g} deg",
            got=f"{format_against_limit(off_mm, COAXIAL_MM, 2)} mm, {math.degrees(turned_rad):.2f} deg",
            action="The assistant stays where it is. Repeat the step, or send the arms home.",
        )
    context.find(
        f"at {context.trajectory} the instrument is {off_mm:.2f} mm and {math.degrees(turned_rad):.2f} deg "
        "from the axis of the guide, by the joints of both arms"
    )
    return off_mm, turned_rad


def _look_at_assistant(
    context: StepContext, occasion: str, sides: ArrivedSides = AS_KNOWN, count: int = CAREFUL_FRAMES
) -> JudgedReading:
    """Look at the room with the assistant out; raises as `check_room`. A hidden head is for the guards."""
    try:
        return check_room(context, occasion, count, sides).judged
    except PatientUnseen:
        frames, _ = read_frames_at_rest(context.workcell, count=count)
        watch = room_watch(context)
        return watch.judge(watch.read(context.workcell, frames, sides))


def _require_seen_coaxial(
    context: StepContext, axis: InsertionAxis, missed: Sequence[str]
) -> BesideBore | None:
    """Return how far the instrument may be beside the bore, by the tracker. Raises CAL-023 and PRO-007.

    Where it does not see the assistant, the joints alone count, provided that no look before was `missed`.
    """
    sides = {} if axis.arriving is None else {Tracked.ASSISTANT: axis.arriving}
    for count in (CAREFUL_FRAMES, BETTER_FRAMES):
        judged = _look_at_assistant(context, f"over {context.trajectory}", sides, count)
        found = beside_bore(context.workcell, room_watch(context), judged)
        if found is None or found.is_within:
            break
        context.progress(0.72, f"looking again over {context.trajectory}: the instrument is {found}")
    if found is None and missed:
        raise GateFailed(
            f"over {context.trajectory} the tracker does not see the frame on the assistant, nor did it "
            f"earlier at this target {', '.join(missed)}: nothing shows that the assistant's cart has stood "
            "still",
            action="Send the arms home, clear the line of sight, and go to the target again.",
        )
    if Tracked.ARM not in judged.look.frames:
        _require_guide_in_place(context)
    if found is None:
        context.find(
            f"over {context.trajectory} the tracker does not see the frame on the assistant: joints alone "
            "count; before it left, it was seen where it stood"
        )
        return None
    hidden = "" if Tracked.ARM in judged.look.frames else "; the guide's arm is hidden: its joints count"
    context.find(f"over {context.trajectory}, by the tracker: the instrument is {found}{hidden}")
    if not found.is_within:
        raise GateFailed(
            f"over {context.trajectory} the instrument may be further beside the bore than it gives way",
            limit=f"{LARGEST_OFF_MM:g} mm",
            got=f"{format_against_limit(found.largest_mm, LARGEST_OFF_MM, 2)} mm",
            action="Nothing is led into the guide. Clear the tracker's line of sight to the frames of both "
            "arms and repeat the step; if it comes again, send the arms home and localize again.",
        )
    return found


def _require_guide_in_place(context: StepContext) -> None:
    """Raise PRO-007 unless the frame on the guide shows it where it was held, while its arm is hidden."""
    rest = context.setting.memory.find(GuideAtRest)
    if rest is not None:
        rest.look(context.workcell, room_watch(context))
    if rest is None or rest.is_unseen:
        raise GateFailed(
            f"over {context.trajectory} the tracker sees neither the frame on the arm with the guide nor the "
            "one on the guide: nothing shows that the bore is where it was",
            action="Nothing is led into the guide. Clear the line of sight to one of them, repeat the step.",
        )
    if rest.now_mm > PUSHED_MM:
        raise GateFailed(
            f"over {context.trajectory} the guide is not where it was held, while its arm is hidden",
            limit=f"{PUSHED_MM:g} mm",
            got=f"{format_against_limit(rest.now_mm, PUSHED_MM, 2)} mm",
            action="Nothing is led into the guide. Send the arms home and localize again.",
        )


def _parts_at_bore(context: StepContext) -> tuple[str, ...]:
    """Return the names of the guide's parts around its bore."""
    bodies = context.setting.surroundings.guide
    return tuple(
        one.name
        for one in bodies
        if min(math.hypot(*one.start_mm[:2]), math.hypot(*one.end_mm[:2])) < NEAR_BORE_MM
    )


def guided_stretch(context: StepContext, stop: DepthStop) -> GuidedStretch:
    """Return where the bore leads the instrument and its tip is off the skin."""
    bore_mm = context.workcell.tools.guide.bore.length_mm
    return GuidedStretch(ABOVE_GUIDE_MM + MOUTH_MM, ABOVE_GUIDE_MM + bore_mm + stop.standoff_mm - OFF_SKIN_MM)
