"""Work at the target, stage by stage, through a guide held outside the skin.

The arm with the guide rests from before the first stage until the instrument is confirmed to be out; an
assistant may lead it in and out meanwhile. Its tip is at the target when its depth stop rests on the guide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.errors import InsertionDisturbed, RoomUndecided
from procedures.guards.guide_displacement import PUSHED_MM, GuideAtRest, measure_guide_at_rest
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.room_watch import RoomWatch
from procedures.journal.errors import GateFailed, JournalNotWritable
from procedures.journal.results import FramedPose, StepResult
from procedures.operator.errors import GuardUnmet, NotConfirmed
from procedures.operator.question import YES, Question, Task, Topic
from procedures.steps.branches import HOLD_GUIDE, tell_holding
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import AssistedInsertion, CranialOpening, KnownBases
from procedures.steps.clinical.room import ROOM_READS, check_room, require_head_in_view
from procedures.steps.clinical.two_arms.assisted_drilling import drill_with_assistant
from procedures.steps.clinical.two_arms.assisted_insertion import (
    insert_with_assistant,
    send_assistant_home,
    withdraw_assistant,
)
from procedures.steps.clinical.two_arms.skull_opening import describe_opening
from procedures.steps.clinical.work_progress import (
    STAGES,
    DepthStop,
    WorkProgress,
    WorkStage,
    describe_work,
    work_progress,
)
from procedures.steps.conditions import needs_insertion
from ronna_hw.errors import RonnaError
from ronna_hw.text import format_against_limit
from ronna_hw.wire.room_tasks import DRILL

# Safety against a guide beside its target (U).
POSITION_LIMIT_MM = 0.05  # nominal place against the commanded one; more means the arm did not arrive

UNSEEN = "the tracker sees no frame on the arm or the guide; only the joints show a push on the guide"
STAGE_ANSWERS = (YES, HOLD_GUIDE)
Insert = Callable[[StepContext, DepthStop], AssistedInsertion]
Drill = Callable[[StepContext, DepthStop], CranialOpening | None]


class ReachedTarget(StepResult, kind="at_target", version=4):
    """Pose of the held guide and depth of the instrument.

    During work finished on an earlier visit, the guide was not watched.
    """

    tool_pose: FramedPose | None = Field(
        description="Nominal pose robot <- tool at the measured joints; none if the work "
        "was finished earlier."
    )
    nominal_error_mm: float | None = Field(
        description="Error of the instrument's end from joints and depth stop: across the axis and along it."
    )
    too_deep_mm: float = Field(
        description="Depth error from the reading of the depth stop; part of that error."
    )
    depth_stop: DepthStop = Field(description="Depth stop of the instrument.")
    pushed_mm: float | None = Field(
        description="Largest displacement of the guide after a stage; none where no push was seen and the "
        "tracker did not see the guide after each. One that was released before is a finding."
    )
    assisted: AssistedInsertion | None = Field(
        default=None, description="Insertion by the assistant; none by hand or on an earlier visit."
    )
    opening: CranialOpening | None = Field(
        default=None, description="Opening of the skull by the assistant's drill; none by hand."
    )
    done_before: tuple[str, ...] = Field(
        default=(), description="Stages done when the guide was there earlier, and not repeated."
    )


def run(
    context: StepContext, insert: Insert | None = None, drill: Drill | None = None
) -> Outcome[ReachedTarget]:
    """Check the arm's position, then guide depth stop setting, work stages and instrument removal.

    The instrument goes in by hand unless `insert` has an arm insert it; so with the drill and `drill`.
    """
    workcell, trajectory = context.workcell, context.trajectory
    commanded = context.result(PositionedGuide).tool_pose.transform
    axis = workcell.master.place.axis
    reached = workcell.master.tool_pose(arrived=None if axis is None else axis.arriving)
    deviation_mm = reached.translation_mm - commanded.translation_mm
    error_mm = float(np.linalg.norm(deviation_mm))
    if error_mm > POSITION_LIMIT_MM:
        raise GateFailed(
            "the arm is not where it was sent",
            limit=f"{POSITION_LIMIT_MM} mm",
            got=f"{format_against_limit(error_mm, POSITION_LIMIT_MM, 3)} mm",
        )
    _check_room_again(context)
    workcell.master.hold()
    with require_head_in_view(context), _watch_guide(context) as rest:
        _look(context, rest)  # the cart may have been moved since the arm came here
        context.progress(0.0, f"the guide is looked at before the work at {trajectory}")
        work_so_far = work_progress(context)
        context.progress(0.0, f"the guide is held at {trajectory}")  # the guards look whether it is displaced
        for stage in STAGES:
            if stage.task not in work_so_far.done:
                with _record_interruption(context, stage):
                    _do_stage(context, stage, work_so_far, insert, drill)
                    _look_at_guide(context, stage, rest, work_so_far)
                    share = (STAGES.index(stage) + 1) / (len(STAGES) + 1)
                    context.progress(share, f"{stage.done_statement} at {trajectory}")
        withdraw_assistant(context, work_so_far.stop)
        context.request_instrument_removal()  # from here on, the work counts as finished whatever happens
    send_assistant_home(context)
    if work_so_far.finished_before:
        return _build_unwatched_outcome(context, work_so_far)
    if unseen := rest.describe_unseen():
        context.find(
            f"during the work at {trajectory} the tracker did not see {unseen}: what was displaced meanwhile "
            "and has gone back was not noticed"
        )
    pushed = work_so_far.pushed_mm > PUSHED_MM
    if pushed:
        context.find(f"the guide was pushed by up to {work_so_far.pushed_mm:.2f} mm at {trajectory}")
    too_deep_mm = work_so_far.stop.too_deep_mm
    error_mm = float(np.linalg.norm(deviation_mm + too_deep_mm * commanded.rotation_matrix[:, 2]))
    return Outcome(
        ReachedTarget(
            tool_pose=FramedPose.of(reached),
            nominal_error_mm=error_mm,
            too_deep_mm=too_deep_mm,
            depth_stop=work_so_far.stop,
            pushed_mm=work_so_far.pushed_mm if work_so_far.watched or pushed else None,
            assisted=work_so_far.assisted,
            opening=_opening_at(context),
            done_before=work_so_far.before,
        ),
        summary=f"instrument within {error_mm:.2f} mm of where it was sent"
        + (
            f", by joints and depth stop; the guide was pushed by {work_so_far.pushed_mm:.2f} mm"
            if pushed
            else ""
        )
        + ("" if work_so_far.watched else "; the guide was not watched throughout"),
    )


def _build_unwatched_outcome(context: StepContext, work_so_far: WorkProgress) -> Outcome[ReachedTarget]:
    """Return the outcome of work finished on an earlier, unwatched visit."""
    return Outcome(
        ReachedTarget(
            tool_pose=None,
            nominal_error_mm=None,
            too_deep_mm=work_so_far.stop.too_deep_mm,
            depth_stop=work_so_far.stop,
            pushed_mm=None,
            opening=_opening_at(context),
            done_before=work_so_far.before,
        ),
        summary="the work was finished earlier; the guide was not watched then",
    )


def _opening_at(context: StepContext) -> CranialOpening | None:
    """Return the opening that the assistant has drilled, also before an interruption."""
    opening = context.workcell.master.instrument.stages.opening_at(context.trajectory)
    return None if opening is None else CranialOpening.of_stage(opening, context.trajectory)


def _do_stage(
    context: StepContext,
    stage: WorkStage,
    work_so_far: WorkProgress,
    insert: Insert | None,
    drill: Drill | None,
) -> None:
    """Have one stage done and confirmed. Raises PRO-002 unless it is confirmed, and TOOL-007."""
    trajectory, stop, stages = context.trajectory, work_so_far.stop, context.workcell.master.instrument.stages
    before = f"; earlier: {describe_work(stages, trajectory)}" if stages.tasks_at(trajectory) else ""
    if stage is STAGES[-1]:
        work_so_far.rely_on_stop(context)
    stages.record_begin(trajectory, stage.task)
    by_arm = insert if stage is STAGES[-1] else None
    is_led = any(arm.leads_instrument for arm in context.workcell.arms.values())
    if by_arm and not (is_led and work_so_far.assisted and context.doubt(KnownBases) is None):
        work_so_far.assisted = None
        work_so_far.assisted = by_arm(context, stop)
    opening = drill(context, stop) if drill and stage.task == DRILL else None
    drilled = "" if opening is None else f"by the assistant: {describe_opening(opening)}; "
    question = Question(
        stage.topic,
        stage.asked.format(trajectory),
        f"{drilled}depth stop {stop.read_mm:.2f} mm, computed {stop.computed_mm:.2f} mm; the guide is held "
        f"{stop.standoff_mm:.0f} mm in front of the entry{before}{tell_holding(STAGE_ANSWERS)}",
        STAGE_ANSWERS,
        trajectory=trajectory,
        timeout_s=None,
    )
    with context.watching(f"the hold at {trajectory}"):
        if not by_arm and opening is None:
            context.perform_task(Task(stage.task, f"{stage.instruction} at {trajectory}", trajectory))
        answer = context.choose(question)
        if answer == YES:  # done, whatever the watch has seen meanwhile
            stages.record_done(trajectory, stage.task)
            work_so_far.done.append(stage.task)
    if answer != YES:
        raise NotConfirmed(
            f"nobody confirmed at {trajectory} that {stage.done_statement}",
            action="Nothing moves. Repeat the step, or remove the instrument and send "
            f"{context.workcell.phrases.arms} home.",
        )


@contextmanager
def _record_interruption(context: StepContext, stage: WorkStage) -> Iterator[None]:
    """Record what ends a stage early, for the next question about it. An answer needs no record."""
    try:
        yield
    except RonnaError as error:
        if not isinstance(error, NotConfirmed):
            with suppress(JournalNotWritable):  # the error that ended the stage is reported
                context.workcell.master.instrument.stages.record_interruption(
                    context.trajectory, stage.task, error.summary
                )
        raise


def _look_at_guide(
    context: StepContext, stage: WorkStage, rest: GuideAtRest, work_so_far: WorkProgress
) -> None:
    """Measure the guide after a stage. If it is displaced, a guard suspends the case."""
    _look(context, rest)
    work_so_far.pushed_mm = max(work_so_far.pushed_mm, rest.now_mm)
    if rest.is_unseen:
        work_so_far.watched = False
        if rest.known:  # else reported before the work began
            context.find(f"at {context.trajectory}, {stage.done_statement}: {UNSEEN}")


def _look(context: StepContext, rest: GuideAtRest) -> None:
    rest.look(context.workcell, context.setting.memory.find(RoomWatch))


def _check_room_again(context: StepContext) -> None:
    """Check the room after a return to the step or if nothing watches the head. Raises PRO-019, PRO-020."""
    memory = context.setting.memory
    rest = memory.find(GuideAtRest)
    if memory.find(RoomWatch) is None or (rest is not None and rest.was_worked_through):
        check_room(context, f"at {context.trajectory}", CAREFUL_FRAMES)


@contextmanager
def _watch_guide(context: StepContext) -> Iterator[GuideAtRest]:
    """Measure the guide against its rest position during the block.

    Raises PRO-019 or PRO-020 if a push that ends the step is a move of cart or head.
    """
    memory = context.setting.memory
    rest = memory.find(GuideAtRest)
    if rest is None or rest.trajectory != context.trajectory:
        rest = measure_guide_at_rest(context.workcell, context.trajectory, find=context.find)
        memory.keep(rest)
    if not rest.known:
        context.find(f"at {context.trajectory}: {UNSEEN}")
    rest.is_worked_through = True
    try:
        yield rest
    except (GuardUnmet, InsertionDisturbed):
        if rest.now_mm > PUSHED_MM:  # by a hand; or the cart has moved, and the arm with it
            with suppress(RoomUndecided):  # what ends the step says more
                check_room(context, f"at {context.trajectory}")
        raise
    finally:
        rest.is_worked_through, rest.was_worked_through = False, True


STEP = StepSpec(
    ReachedTarget,
    "Work through the guide",
    Phase.OPERATION,
    run,
    asks=(Topic.DEPTH_STOP, *(stage.topic for stage in STAGES), Topic.INSTRUMENT_OUT),
    scope=Scope.TRAJECTORY,
    reads=(PositionedGuide, CheckedPlan, *ROOM_READS, LocalizedFiducials),
    continues=True,
    finishes=True,
    preconditions=needs_insertion,
)
WITH_ASSISTANT = replace(
    STEP,
    run=partial(run, insert=insert_with_assistant, drill=drill_with_assistant),
    others_move=True,
    reads=(*STEP.reads, ImportedCt),
    asks=(
        Topic.DEPTH_STOP,
        *(stage.topic for stage in STAGES[:-1]),
        Topic.INSTRUMENT_OUT,  # before the assistant moves, and after it has led drill or instrument out
        Topic.APPROACH,
        Topic.BREAKTHROUGH,
        STAGES[-1].topic,
        Topic.RETREAT,
    ),
)
