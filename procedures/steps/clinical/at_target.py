"""At the target: the guide is held outside the skin, and someone works through it, stage by stage.

From before the first stage until the instrument is confirmed to be out, nothing moves. The instrument's tip
is at the target when its depth stop rests on the guide.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.guide_still import PUSHED_MM, GuideAtRest, guide_at_rest
from procedures.guards.room_watch import RoomWatch
from procedures.journal.errors import GateFailed
from procedures.journal.results import FramedPose, StepResult
from procedures.operator.errors import GuardUnmet, NotConfirmed
from procedures.operator.question import Question, Task, Topic
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.tools.begun_work import STAGES, BegunWork, WorkStage, begun_work, done_in_words
from procedures.steps.clinical.tools.depth_stop import DepthStop
from procedures.steps.clinical.validity.room import ROOM_READS, check_room, head_must_show
from procedures.steps.conditions import inserted
from ronna_hw.text.beyond import beyond

POSITION_LIMIT_MM = 0.05  # nominal place against the commanded one; more means the arm did not arrive
HOLD = "hold"  # the instrument stays where it is, and the case is held
STAYS = "Nothing moves. Repeat the step, or remove the instrument and send the arm home."
UNSEEN = "the tracker does not see the frame on the arm; only the joints show a push on the guide"
DONE = "done"  # the one word that ends a stage
DWELL_S = 0.5  # of theatre time, before the reading


class ReachedTarget(StepResult, kind="at_target", version=4):
    """How the guide was held, and how deep the instrument went.

    Of work that had been finished before, when the guide was there earlier, nothing watched how it was held.
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
    done_before: tuple[str, ...] = Field(
        default=(), description="Stages done when the guide was there earlier, and not repeated."
    )


def run(context: StepContext) -> Outcome[ReachedTarget]:
    """Read the arm at rest, have the depth stop set, the work done stage by stage, the instrument out."""
    workcell, trajectory = context.workcell, context.trajectory
    commanded = context.result(PositionedGuide).tool_pose.transform
    context.setting.clock.sleep(DWELL_S)
    axis = workcell.place.axis
    reached = workcell.tool_pose(arrived=None if axis is None else axis.arriving)
    beside_mm = reached.translation_mm - commanded.translation_mm
    error_mm = float(np.linalg.norm(beside_mm))
    if error_mm > POSITION_LIMIT_MM:
        raise GateFailed(
            "the arm is not where it was sent",
            limit=f"{POSITION_LIMIT_MM} mm",
            got=f"{beyond(error_mm, POSITION_LIMIT_MM, 3)} mm",
        )
    _check_room_again(context)
    workcell.hold()
    with head_must_show(context), _watched_guide(context) as rest:
        begun = begun_work(context)
        context.progress(0.0, f"the guide is held at {trajectory}")  # or was left displaced: it is looked at
        for stage in STAGES:
            if stage.task not in begun.done:
                _work(context, stage, begun)
                _look_at_guide(context, stage, rest, begun)
                share = (STAGES.index(stage) + 1) / (len(STAGES) + 1)
                context.progress(share, f"{stage.confirms} at {trajectory}")
        context.have_instrument_out()  # nothing that comes now may keep the work from counting as finished
    if begun.finished_before:
        return _not_watched(begun)
    pushed = begun.pushed_mm > PUSHED_MM
    if pushed:
        context.find(f"the guide was pushed by up to {begun.pushed_mm:.2f} mm at {trajectory}")
    too_deep_mm = begun.stop.too_deep_mm
    error_mm = float(np.linalg.norm(beside_mm + too_deep_mm * commanded.rotation_matrix[:, 2]))
    return Outcome(
        ReachedTarget(
            tool_pose=FramedPose.of(reached),
            nominal_error_mm=error_mm,
            too_deep_mm=too_deep_mm,
            depth_stop=begun.stop,
            pushed_mm=begun.pushed_mm if begun.watched or pushed else None,
            done_before=begun.before,
        ),
        summary=f"instrument within {error_mm:.2f} mm of where it was sent"
        + (f", by joints and depth stop; the guide was pushed by {begun.pushed_mm:.2f} mm" if pushed else "")
        + ("" if begun.watched else "; the guide was not watched throughout"),
    )


def _not_watched(begun: BegunWork) -> Outcome[ReachedTarget]:
    """The present position of the guide says nothing about where it was during the work."""
    return Outcome(
        ReachedTarget(
            tool_pose=None,
            nominal_error_mm=None,
            too_deep_mm=begun.stop.too_deep_mm,
            depth_stop=begun.stop,
            pushed_mm=None,
            done_before=begun.before,
        ),
        summary="the work was finished earlier; the guide was not watched then",
    )


def _work(context: StepContext, stage: WorkStage, begun: BegunWork) -> None:
    """Have one stage done and confirmed; raises PRO-002 unless it is said to be done, TOOL-007."""
    trajectory, stop, stages = context.trajectory, begun.stop, context.workcell.instrument.stages
    known = stages.at(trajectory)
    before = f"; earlier: {done_in_words(known)}" if known else ""
    if stage is STAGES[-1]:
        begun.rely_on_stop(context)
    stages.begins(trajectory, stage.task)
    context.have_done(Task(stage.task, f"{stage.does} at {trajectory}", trajectory))
    question = Question(
        stage.topic,
        f"at {trajectory}: {stage.confirms}",
        f"depth stop {stop.read_mm:.2f} mm, computed {stop.computed_mm:.2f} mm; the guide is held "
        f"{stop.standoff_mm:.0f} mm in front of the entry{before}",
        (DONE, HOLD),
        trajectory=trajectory,
        timeout_s=None,
    )
    with context.watching(f"the hold at {trajectory}"):
        answer = context.choose(question)
        if answer == DONE:  # it is done, whatever the watch has seen meanwhile
            stages.is_done(trajectory, stage.task)
            begun.done.append(stage.task)
    if answer != DONE:
        raise NotConfirmed(f"nobody confirmed at {trajectory} that {stage.confirms}", action=STAYS)


def _look_at_guide(context: StepContext, stage: WorkStage, rest: GuideAtRest, begun: BegunWork) -> None:
    """After a stage: the guard at the next checkpoint suspends if it is out of place."""
    rest.look(context.workcell, context.setting.clock)
    begun.pushed_mm = max(begun.pushed_mm, rest.now_mm)
    if rest.unseen:
        begun.watched = False
        if rest.seen_mm is not None:  # else it was told before the work began
            context.find(f"at {context.trajectory}, {stage.confirms}: {UNSEEN}")


def _check_room_again(context: StepContext) -> None:
    """Where the step was left, or nothing watches the head, as after a resume. Raises PRO-019 and PRO-020."""
    memory = context.setting.memory
    rest = memory.find(GuideAtRest)
    if memory.find(RoomWatch) is None or (rest is not None and rest.left):
        check_room(context, f"at {context.trajectory}")


@contextmanager
def _watched_guide(context: StepContext) -> Iterator[GuideAtRest]:
    """Within, the guide is compared with how it had come to rest, before anybody touched it.

    Raises PRO-019 and PRO-020 where it was left because of a push that was none.
    """
    memory = context.setting.memory
    rest = memory.find(GuideAtRest)
    if rest is None or rest.trajectory != context.trajectory:
        room = memory.find(RoomWatch)
        rest = guide_at_rest(context.workcell, context.setting.clock, context.trajectory, room)
        memory.keep(rest)
    if rest.seen_mm is None:
        context.find(f"at {context.trajectory}: {UNSEEN}")
    rest.worked = True
    try:
        yield rest
    except GuardUnmet:
        if rest.now_mm > PUSHED_MM:  # by a hand; or the cart has moved, and the arm with it
            check_room(context, f"at {context.trajectory}")
        raise
    finally:
        rest.worked, rest.left = False, True


STEP = StepSpec(
    ReachedTarget,
    "Work through the guide",
    Phase.OPERATION,
    run,
    asks=(Topic.DEPTH_STOP, *(stage.topic for stage in STAGES), Topic.INSTRUMENT_OUT),
    scope=Scope.TRAJECTORY,
    reads=(PositionedGuide, CheckedPlan, *ROOM_READS),
    continues=True,
    finishes=True,
    preconditions=inserted,
)
