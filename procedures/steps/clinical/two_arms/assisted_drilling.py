"""Drilling of the skull by the assistant, through the guide that the master holds.

The drill's stop is set so that it rests on the guide just behind the skull as the CT shows it. The assistant
leads the drill to in front of the bone, there the staff switch it on, and it is fed until the force shows the
breakthrough. One that is too early or too late by the CT, or where the CT has two readings, is for the
operator. The opening is recorded as soon as the feed has ended; where the force fell, no repetition feeds
deeper. The drill is led out and put away before anything else goes through the guide.
"""

from __future__ import annotations

from typing import NamedTuple

from procedures.engine.context import StepContext
from procedures.operator.question import Task
from procedures.planning.skull_section import SkullSection, measure_skull
from procedures.steps.clinical.ct_import import volume_of
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import CranialOpening
from procedures.steps.clinical.two_arms.force_check import require_true_force
from procedures.steps.clinical.two_arms.insertion_axis import ABOVE_GUIDE_MM
from procedures.steps.clinical.two_arms.over_guide import (
    LoadedTool,
    OverGuide,
    bring_over_guide,
    close_earlier_way,
    guided_stretch,
    look_back,
)
from procedures.steps.clinical.two_arms.skull_opening import (
    EARLY_MM,
    TOUCH_N,
    accept_opening,
    find_doubt,
    require_bone,
)
from procedures.steps.clinical.work_progress import STOP_LIMIT_MM, DepthStop
from procedures.steps.errors import DEPTH_STOP_WRONG
from procedures.workcell import InsertionAxis
from procedures.workcell.arm_history import HeldDrill
from procedures.workcell.assistant import DrillPlan, GuidedStretch
from ronna_hw.devices.contact import INSERTION_SPEED_MM_S, DrillLimits, Inserted
from ronna_hw.wire.room_tasks import DRILL_HOLDER, TURN_DRILL

# Safety against a drill fed too fast (U).
FEED_MM_S = 0.5  # a stop from there takes a hundredth of a mm
# Behind the inside of the skull by the CT the stop rests on the guide, and no set-point is beyond. It leaves
# room for the point of the drill and what CT and arms err.
# Safety against a drill that plunges (U).
BEHIND_SKULL_MM = 2.5
# Safety against a drill that is switched on in bone (U).
BEFORE_BONE_MM = 2.0  # of the tip, where the drill is switched on: more than CT and arms err
# Safety against a drill pressed until its limit trips (U).
SLOW_SHARE = 0.6  # of the limit: from there on the feed is slowed
# Across the axis: an arm of 80 N/mm yields by 0.1 mm, half of what the guide may move.
# Safety against a drill that is pressed aside (U).
SIDE_N = 8.0
# Safety against a drill whose force says nothing: a wrong scale, a dead axis (U).
BLIND_MM = 0.5  # by which a feed without bone may have been longer
BONE_BY_MM = 2.0  # behind the skull's outside by the CT, or behind an opening begun earlier
# Safety against a breakthrough that is not noticed (U).
FREE_N = 1.0  # two standard errors of a sensor's force at most; diploe resists with 2 N (U)
FALL_SHARE = 0.4  # of the force in the inner cortex: the point of the drill is through (U)
FREE_MM = 0.6  # of feed without any resistance: thinner than any diploe without bone (U)


class DrillDepths(NamedTuple):
    """Depths behind the entry, and how far the clamp is from the start of its axis at depth 0."""

    skull: SkullSection
    at_entry_mm: float

    @property
    def deepest_mm(self) -> float:
        return self.skull.inside_mm + BEHIND_SKULL_MM

    @property
    def from_mm(self) -> float:
        return self.skull.outside_mm - BEFORE_BONE_MM

    def bone_by_mm(self, begun_mm: float | None, *, met_bone: bool = True) -> float:
        """Return where bone must have been felt; an opening begun earlier has none up to its bottom.

        No repetition adds to a hole that was drilled blindly: one that goes no deeper than a first feed
        without bone, or whose last feed has not `met_bone`.
        """
        bone_by_mm = self.skull.outside_mm + BONE_BY_MM
        if begun_mm is None or begun_mm <= bone_by_mm + BLIND_MM:
            return bone_by_mm
        return min(begun_mm + (BONE_BY_MM if met_bone else 0.0), self.deepest_mm - BLIND_MM)


def drill_with_assistant(context: StepContext, stop: DepthStop) -> CranialOpening | None:
    """Have the assistant drill the skull, and return the opening; None if a hand is to drill.

    Raises PRO-002, PRO-007, TOOL-004 and, as the way over the guide and the arm, what stops an insertion.
    """
    assistant, trajectory, settings = context.workcell.assistant, context.trajectory, context.setting.settings
    if not settings.assistant_drills:
        return None
    depths = _find_depths(context, stop)
    if depths is None:
        return None
    stages = context.workcell.master.instrument.stages
    recorded = stages.opening_at(trajectory)
    earlier = None if recorded is None else CranialOpening.of_stage(recorded, trajectory)
    if earlier is not None and earlier.force_fell:
        return _keep_opening(context, earlier)
    stop_mm = stop.bore_mm + stop.standoff_mm + depths.deepest_mm
    limit_N = settings.drill_force_N
    begun_mm = assistant.drilled_mm(trajectory)

    def ask(axis: InsertionAxis) -> str:
        skull, interruption = depths.skull, stages.interruption_at(trajectory)
        begun = "" if begun_mm is None else f", with the tip {begun_mm:.1f} mm behind the entry"
        if begun or interruption:
            why = f": {interruption}" if interruption else ""
            begun = f" DRILLING WAS BEGUN THERE{begun}, and interrupted{why}."
        doubt = f" CAUTION: {skull.doubt}." if skull.doubt else ""
        return (
            f"May the assistant bring the drill over the guide at {trajectory}, lead it at "
            f"{INSERTION_SPEED_MM_S:g} mm/s to {BEFORE_BONE_MM:g} mm off the bone and, once it is switched "
            f"on, drill at {FEED_MM_S:g} mm/s? By the CT the skull is {skull.outside_mm:.1f} to "
            f"{skull.inside_mm:.1f} mm behind the entry; the drill ends where the force shows the "
            f"breakthrough, at {limit_N:g} N, or at {depths.deepest_mm:.1f} mm, where its stop rests on the "
            f"guide.{doubt}{begun}"
        )

    def load(context: StepContext) -> None:
        _load_drill(context, stop_mm)

    held = HeldDrill(entry_mm=depths.at_entry_mm)
    over = bring_over_guide(context, LoadedTool(stop_mm, held, load, ask, require_true_force))
    axis = assistant.axis_in_base(over.axis)
    context.progress(0.3, f"the assistant leads the drill to the bone at {trajectory}")
    guided = guided_stretch(context, stop)
    assistant.lead_in(axis, depths.at_entry_mm + depths.from_mm, guided, "the drill")
    assistant.record_drill(may_turn=True)
    context.perform_task(
        Task(TURN_DRILL, f"switch the drill for {trajectory} on, and keep it running", trajectory)
    )
    context.progress(0.4, f"the assistant drills at {trajectory}")
    met_bone_before = earlier is None or earlier.met_bone
    plan = _plan_feed(depths, limit_N, depths.bone_by_mm(begun_mm, met_bone=met_bone_before))
    drilled = assistant.drill(axis, plan)
    depth_mm = assistant.require_on_axis() - depths.at_entry_mm
    opening = _build_opening(depths, plan, over, drilled, depth_mm, assistant.force_error_N)
    stages.record_opening(trajectory, opening.model_dump(mode="json"))
    context.rest_drill()
    require_bone(context, opening, begun_mm)
    opening = accept_opening(context, opening)
    _put_drill_away(context, guided)
    return opening


def _find_depths(context: StepContext, stop: DepthStop) -> DrillDepths | None:
    """Find the depths at which to drill, None (with a finding) where only a hand may drill."""
    trajectory = context.trajectory
    if not context.workcell.assistant.senses_force:
        context.find(f"at {trajectory} a hand drills: the assistant senses no force")
        return None
    error_N = context.workcell.assistant.force_error_N
    if not error_N:
        context.find(f"at {trajectory} a hand drills: no error is stated of the assistant's force")
        return None
    if error_N > FREE_N:  # bone could not be told from no bone
        context.find(
            f"at {trajectory} a hand drills: the force of the assistant errs by {error_N:g} N "
            f"(force_error_N), and a breakthrough shows at up to {FREE_N:g} N"
        )
        return None
    planned = context.result(CheckedPlan).trajectory(trajectory)
    skull = measure_skull(volume_of(context), planned.trajectory)
    if skull is None:
        context.find(f"at {trajectory} a hand drills: the CT shows no skull with an inside on its way")
        return None
    if skull.doubt:
        context.find(f"at {trajectory} the skull in the CT: {skull.doubt}")
    return DrillDepths(skull, ABOVE_GUIDE_MM + stop.bore_mm + stop.standoff_mm)


def _load_drill(context: StepContext, stop_mm: float) -> None:
    """Have the drill put into the holder, its stop set. Raises TOOL-004 if the stop is set wrong."""
    trajectory = context.trajectory
    task = Task(
        DRILL_HOLDER,
        f"set the stop of the drill for {trajectory} to {stop_mm:.2f} mm from its tip, put it into the "
        "assistant's holder, its stop against the clamp, and close the clamp; it stays switched off",
        trajectory,
        (stop_mm,),
        ("from the tip of the drill to its stop in mm",),
        (1.0, 2.0 * stop_mm),
    )
    (read_mm,) = context.perform_task(task)
    if abs(read_mm - stop_mm) > STOP_LIMIT_MM:
        raise DEPTH_STOP_WRONG(
            f"the stop of the drill for {trajectory} is set wrong",
            expected=f"{stop_mm:.2f} mm",
            limit=f"{STOP_LIMIT_MM:g} mm from it",
            got=f"{read_mm:.2f} mm",
        )


def _plan_feed(depths: DrillDepths, limit_N: float, bone_by_mm: float) -> DrillPlan:
    limits = DrillLimits(
        slow_N=SLOW_SHARE * limit_N,
        touch_N=TOUCH_N,
        free_N=FREE_N,
        fall_share=FALL_SHARE,
        earliest_mm=BEHIND_SKULL_MM + EARLY_MM,
        free_mm=FREE_MM,
        bone_by_mm=depths.deepest_mm - bone_by_mm,
        side_N=SIDE_N,
    )
    at_entry_mm = depths.at_entry_mm
    return DrillPlan(
        at_entry_mm + depths.from_mm, at_entry_mm + depths.deepest_mm, FEED_MM_S, limit_N, limits
    )


def _keep_opening(context: StepContext, earlier: CranialOpening) -> CranialOpening:
    """Return an opening where the force fell earlier, once it counts as drilled: nothing is fed deeper."""
    close_earlier_way(context)
    through = "an opening was through" if earlier.broke_through else "the force fell"
    before = f"; {through} at {earlier.depth_mm:.1f} mm earlier, and the assistant drills no further"
    opening = accept_opening(context, earlier, before)
    context.workcell.master.instrument.record_insertion(context.trajectory)  # the work by hand goes on
    return opening


def _build_opening(
    depths: DrillDepths, plan: DrillPlan, over: OverGuide, drilled: Inserted, depth_mm: float, error_N: float
) -> CranialOpening:
    """Return an opening as the force and the joints have it; nobody has accepted it yet."""
    skull, fell = depths.skull, drilled.broke_through
    goes_on = skull.further_mm is not None and depth_mm < skull.further_mm - EARLY_MM
    opening = CranialOpening(
        planned_outside_mm=skull.outside_mm,
        planned_inside_mm=skull.inside_mm,
        further_inside_mm=skull.further_mm,
        deepest_mm=depths.deepest_mm,
        depth_mm=depth_mm,
        force_fell=fell,
        broke_through=fell and not goes_on,
        met_bone=drilled.met_bone,
        doubt="",
        accepted=False,
        peak_force_N=drilled.peak_force_N or 0.0,
        side_force_N=drilled.side_force_N,
        force_limit_N=plan.limit_N,
        force_error_N=error_N,
        drilled_s=drilled.drilled_s,
        slowed_s=drilled.slowed_s,
        from_mm=depths.from_mm,
        forces_N=drilled.drilled_N,
        off_axis_mm=over.off_axis_mm,
        seen_apart_mm=None if over.seen is None else over.seen.seen_mm,
    )
    return opening.model_copy(update={"doubt": find_doubt(opening)[0]})


def _put_drill_away(context: StepContext, guided: GuidedStretch) -> None:
    """Lead the drill out, have it taken out of the holder, and send the assistant home."""
    workcell = context.workcell
    workcell.start()
    workcell.assistant.lead_out(look_back(context), guided)
    context.request_instrument_removal()
    workcell.assistant.return_home()
    workcell.master.instrument.record_insertion(context.trajectory)  # the work by hand goes on
