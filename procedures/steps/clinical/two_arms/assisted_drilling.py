"""Drilling of the skull by the assistant, through the guide that the master holds.

The drill's stop is set so that it rests on the guide just behind the skull as the CT shows it. The assistant
leads the drill to in front of the bone, there the staff switch it on, and it is fed until the force shows the
breakthrough. One that is too early or too late by the CT, or where the CT has two readings, is for the
operator. The journal has a feed before it begins, and how deep it went as soon as it has ended, in whichever
way: a repetition starts from there, and where the opening may be through none feeds deeper. The drill is led
out and put away before anything else goes through the guide.
"""

from __future__ import annotations

from contextlib import suppress

from procedures.engine.context import StepContext
from procedures.operator.question import Task
from procedures.planning.errors import MetalInSkull
from procedures.planning.skull_section import measure_skull
from procedures.steps.clinical.ct_import import volume_of
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import CranialOpening, FeedEnd
from procedures.steps.clinical.two_arms.drill_plan import (
    BEFORE_BONE_MM,
    FEED_MM_S,
    FREE_N,
    RESISTED_WITHIN_MM,
    BegunOpening,
    DrillDepths,
    plan_feed,
)
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
    accept_opening,
    add_feed,
    find_doubt,
    require_bone,
)
from procedures.steps.clinical.work_progress import STOP_LIMIT_MM, DepthStop
from procedures.steps.errors import DEPTH_STOP_WRONG
from procedures.workcell import InsertionAxis
from procedures.workcell.arm_history import HeldDrill
from procedures.workcell.assistant import GuidedStretch
from ronna_hw.devices.contact import INSERTION_SPEED_MM_S
from ronna_hw.errors import RonnaError
from ronna_hw.wire.room_tasks import DRILL_HOLDER, TURN_DRILL

# Of earlier feeds, for a repetition.
KEPT = (
    *("end", "depth_mm", "resisted_mm", "met_bone", "peak_force_N", "side_force_N"),
    *("drilled_s", "slowed_s", "forces_N"),
)


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
    context.rest_drill()
    begun = BegunOpening.of(assistant.drilled_mm(trajectory), earlier)
    if begun is not None and (why := begun.why_by_hand(depths)):
        _leave_to_hand(context, why)
        return None
    stop_mm = stop.bore_mm + stop.standoff_mm + depths.deepest_mm
    limit_N = settings.drill_force_N

    def ask(axis: InsertionAxis) -> str:
        skull, interruption = depths.skull, stages.interruption_at(trajectory)
        before = "" if begun is None else f", with the tip {begun.depth_mm:.1f} mm behind the entry"
        if before or interruption:
            why = f": {interruption}" if interruption else ""
            before = f" DRILLING WAS BEGUN THERE{before}, and interrupted{why}."
        doubt = f" CAUTION: {skull.doubt}." if skull.doubt else ""
        return (
            f"May the assistant bring the drill over the guide at {trajectory}, lead it at "
            f"{INSERTION_SPEED_MM_S:g} mm/s to {BEFORE_BONE_MM:g} mm off the bone and, once it is switched "
            f"on, drill at {FEED_MM_S:g} mm/s? By the CT the skull is {skull.outside_mm:.1f} to "
            f"{skull.inside_mm:.1f} mm behind the entry; the drill ends where the force shows the "
            f"breakthrough, at {limit_N:g} N, or at {depths.deepest_mm:.1f} mm, where its stop rests on the "
            f"guide.{doubt}{before}"
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
    plan = plan_feed(depths, limit_N, begun)
    unfed = _build_unfed(context, depths, over, limit_N)
    if earlier is not None:
        unfed = unfed.model_copy(update={name: getattr(earlier, name) for name in KEPT})
    _record_opening(context, unfed.model_copy(update={"end": FeedEnd.UNKNOWN}))
    try:
        assistant.drill(axis, plan)
    except BaseException:  # also an interruption: whatever cannot be recorded now stays of unknown depth
        with suppress(RonnaError):
            _record_end(context, unfed, FeedEnd.INTERRUPTED)
        raise
    opening = _record_end(context, unfed, FeedEnd.ENDED)
    assistant.require_on_axis()
    context.rest_drill()
    require_bone(context, opening, None if begun is None else begun.bottom_mm)
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
    try:
        skull = measure_skull(volume_of(context), planned.trajectory)
    except MetalInSkull as error:
        context.find(f"at {trajectory} a hand drills: {error}")
        return None
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


def _keep_opening(context: StepContext, earlier: CranialOpening) -> CranialOpening:
    """Return an opening where the force fell earlier, once it counts as drilled: nothing is fed deeper."""
    close_earlier_way(context)
    through = "an opening was through" if earlier.broke_through else "the force fell"
    before = f"; {through} at {earlier.depth_mm:.1f} mm earlier, and the assistant drills no further"
    opening = accept_opening(context, earlier, before)
    context.workcell.master.instrument.record_insertion(context.trajectory)  # the work by hand goes on
    return opening


def _leave_to_hand(context: StepContext, why: str) -> None:
    """Have what is in the guide led out and removed: the opening may be through, and a hand goes on there."""
    close_earlier_way(context)
    context.find(f"at {context.trajectory} a hand drills: {why}; THE SKULL MAY BE OPEN THERE, look first")
    context.workcell.master.instrument.record_insertion(context.trajectory)


def _build_unfed(
    context: StepContext, depths: DrillDepths, over: OverGuide, limit_N: float
) -> CranialOpening:
    """Return the opening before the first feed: there is none."""
    skull = depths.skull
    return CranialOpening(
        planned_outside_mm=skull.outside_mm,
        planned_inside_mm=skull.inside_mm,
        further_inside_mm=skull.further_mm,
        deepest_mm=depths.deepest_mm,
        end=FeedEnd.INTERRUPTED,
        depth_mm=depths.from_mm,
        force_fell=False,
        broke_through=False,
        met_bone=False,
        doubt="",
        accepted=False,
        peak_force_N=0.0,
        side_force_N=0.0,
        force_limit_N=limit_N,
        force_error_N=context.workcell.assistant.force_error_N,
        drilled_s=0.0,
        slowed_s=0.0,
        from_mm=depths.from_mm,
        forces_N=(),
        off_axis_mm=over.off_axis_mm,
        seen_apart_mm=None if over.seen is None else over.seen.seen_mm,
    )


def _record_end(context: StepContext, unfed: CranialOpening, end: FeedEnd) -> CranialOpening:
    """Record an opening as the force and the joints have it after a feed; nobody has accepted it yet.

    Where the arm tells of none and the tip is no deeper than before, nothing was fed.
    """
    assistant = context.workcell.assistant
    if (fed := assistant.drilled) is not None:
        opening = add_feed(unfed, fed, assistant.drill_tip_mm(fed.joints_rad), end)
    elif assistant.drill_tip_mm() < unfed.from_mm + RESISTED_WITHIN_MM:
        opening = unfed
    else:
        opening = unfed.model_copy(update={"end": FeedEnd.UNKNOWN})
    return _record_opening(context, opening)


def _record_opening(context: StepContext, opening: CranialOpening) -> CranialOpening:
    """Record an opening, and return it with its doubt."""
    doubted = opening.model_copy(update={"doubt": find_doubt(opening)[0]})
    stages = context.workcell.master.instrument.stages
    stages.record_opening(context.trajectory, doubted.model_dump(mode="json"))
    return doubted


def _put_drill_away(context: StepContext, guided: GuidedStretch) -> None:
    """Lead the drill out, have it taken out of the holder, and send the assistant home."""
    workcell = context.workcell
    workcell.start()
    workcell.assistant.lead_out(look_back(context), guided)
    context.request_instrument_removal()
    workcell.assistant.return_home()
    workcell.master.instrument.record_insertion(context.trajectory)  # the work by hand goes on
