"""Insertion of the instrument by the assistant, through the guide that the master holds.

The instrument is clamped at its depth stop. The assistant brings it over the guide, coaxial with the bore,
and leads it straight and slowly until the stop rests on the guide; then its clamp slides. Nothing retreats
unasked.
"""

from __future__ import annotations

from procedures.engine.context import StepContext
from procedures.journal.errors import GateFailed
from procedures.operator.question import Task
from procedures.steps.clinical.results import AssistedInsertion
from procedures.steps.clinical.two_arms.over_guide import (
    OFF_SKIN_MM,
    LoadedTool,
    bring_over_guide,
    guided_stretch,
    look_back,
)
from procedures.steps.clinical.work_progress import DepthStop
from procedures.workcell import InsertionAxis
from ronna_hw.devices.contact import BORE_SPEED_MM_S, INSERTION_SPEED_MM_S
from ronna_hw.wire.room_tasks import HOLDER, SEATED

# Safety against an instrument that is not at its stop (U).
LARGEST_GAP_MM = 0.1  # between stop and guide: the scale is read to half of it


def insert_with_assistant(context: StepContext, stop: DepthStop) -> AssistedInsertion:
    """Have the assistant insert the instrument.

    Raises PRO-002, PRO-007, PLAN-007, DUAL-001 and, for a cart that was moved, as `check_room`.
    """
    assistant, trajectory = context.workcell.assistant, context.trajectory
    depth_mm = stop.read_mm - stop.standoff_mm - context.workcell.tools.guide.bore.length_mm
    limit_N = assistant.insertion_limit_N
    stopped_by = "this arm senses no force"
    if limit_N is not None:
        stopped_by = f"{limit_N - assistant.force_error_N:g} N against it stop it"

    def ask(axis: InsertionAxis) -> str:
        return (
            f"May the assistant bring the instrument over the guide at {trajectory}, then lead it "
            f"{axis.travel_mm:.0f} mm along the bore until its stop rests on the guide, its tip "
            f"{depth_mm:.0f} mm behind the entry? In the bore at up to {BORE_SPEED_MM_S:g} mm/s, from "
            f"{OFF_SKIN_MM:g} mm off the skin on at {INSERTION_SPEED_MM_S:g} mm/s; {stopped_by}."
        )

    over = bring_over_guide(context, LoadedTool(stop.read_mm, None, _load, ask))
    context.progress(0.75, f"the assistant leads the instrument into the guide at {trajectory}")
    assistant.insert(assistant.axis_in_base(over.axis), guided_stretch(context, stop))
    # What moved at the end of the way was seen in too few frames.
    if unknown := look_back(context):
        context.find(f"with the instrument at depth at {context.trajectory}: {unknown}")
    task = Task(
        SEATED,
        f"look whether the depth stop rests on the guide at {trajectory}",
        trajectory,
        reads=("gap between stop and guide in mm",),
        plausible_mm=(0.0, 10.0),
    )
    (gap_mm,) = context.perform_task(task)
    if gap_mm > LARGEST_GAP_MM:
        raise GateFailed(
            f"the depth stop does not rest on the guide at {trajectory}",
            limit=f"{LARGEST_GAP_MM:g} mm",
            got=f"{gap_mm:.2f} mm",
            action="Nothing moves. Repeat the step: the assistant retreats once that is confirmed.",
        )
    seen = over.seen
    return AssistedInsertion(
        off_axis_mm=over.off_axis_mm,
        off_axis_rad=over.off_axis_rad,
        seen_apart_mm=None if seen is None else seen.seen_mm,
        seen_within_mm=None if seen is None else seen.uncertain_mm,
        peak_force_N=None if assistant.inserted is None else assistant.inserted.peak_force_N,
        force_limit_N=assistant.insertion_limit_N,
        force_error_N=None if assistant.insertion_limit_N is None else assistant.force_error_N,
        gap_mm=max(0.0, gap_mm),
    )


def _load(context: StepContext) -> None:
    """Have the instrument put into the assistant's holder."""
    load = (
        f"put the instrument for {context.trajectory} into the assistant's holder, its depth stop against "
        "the clamp, and close the clamp"
    )
    context.perform_task(Task(HOLDER, load, context.trajectory))


def withdraw_assistant(context: StepContext, stop: DepthStop) -> None:
    """Have the assistant lead the instrument straight out, once the operator confirms it.

    Raises PRO-054 if a cart was displaced while the instrument was at its target.
    """
    for assistant in context.workcell.assistants:
        if assistant.leads_instrument:
            context.workcell.start()
            assistant.lead_out(look_back(context), guided_stretch(context, stop))


def send_assistant_home(context: StepContext) -> None:
    """Send the assistant home after the instrument was taken out of its holder."""
    for assistant in context.workcell.assistants:
        if assistant.place.is_out:
            assistant.return_home()
