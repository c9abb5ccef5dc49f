"""Progress of the work through the guide: its stages, the depth stop, and the stage to continue from."""

from __future__ import annotations

from dataclasses import dataclass, field

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.journal.results import Values
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import NO, YES, Task, Topic
from procedures.planning.guide import depth_stop_mm
from procedures.steps.branches import FINISHED, HOLD_GUIDE, SETTINGS, WORK_BEGUN, WRONG_STOP, stage_answer
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import AssistedInsertion
from procedures.steps.conditions import require_recent
from procedures.steps.errors import DEPTH_STOP_WRONG, ReadingTooOld
from procedures.workcell.tools import WorkedStages
from ronna_hw.wire import room_tasks
from ronna_hw.wire.room_tasks import DEPTH_STOP

# A vernier has steps of 0.05 mm: beyond twice that it is set wrong.
# Safety against a depth stop set wrong. Source: the scale's step of 0.05 mm.
STOP_LIMIT_MM = 0.1

UNRECORDED = "more may have been done: the end of the journal may be lost"
BESIDE = "the guide was repositioned since; its axis may miss the opening"


@dataclass(frozen=True)
class WorkStage:
    """Stage of the work through the guide: a task done by hand, and the words to confirm it."""

    task: str
    topic: Topic
    instruction: str
    asked: str  # with {} for the trajectory
    done_statement: str


STAGES = (
    WorkStage(room_tasks.SKIN, Topic.SKIN, "open the skin", "Is the skin open at {}?", "the skin is open"),
    WorkStage(
        room_tasks.DRILL,
        Topic.DRILL,
        "drill the skull",
        "Is the skull drilled at {}?",
        "the skull is drilled",
    ),
    WorkStage(room_tasks.DURA, Topic.DURA, "open the dura", "Is the dura open at {}?", "the dura is open"),
    WorkStage(
        room_tasks.INSERT,
        Topic.AT_TARGET,
        "insert the instrument until its stop rests on the guide",
        "Is the instrument at depth at {}, and is the work there done?",
        "the instrument is at depth and the work there is done",
    ),
)


@dataclass
class WorkProgress:
    """Progress of the work through the guide, which an interrupted step resumes.

    `before` are the tasks of stages done on an earlier visit, which are not repeated. `watched` says that the
    tracker saw the guide after each stage since, `pushed_mm` is its largest displacement after one.
    `stop_read_s` is the theatre time of the depth stop's reading until the instrument goes in.
    """

    trajectory: str
    stop: DepthStop
    before: tuple[str, ...] = ()
    done: list[str] = field(default_factory=list)  # tasks
    watched: bool = True
    pushed_mm: float = 0.0
    stop_read_s: float | None = None
    journeys: int = 0  # of the arm with the guide
    assisted: AssistedInsertion | None = None  # unless a hand inserts the instrument

    @property
    def visit(self) -> tuple[str, int]:
        """Trajectory, and the arm's journeys until then: the same while the guide stays there."""
        return self.trajectory, self.journeys

    @property
    def finished_before(self) -> bool:
        """Whether all stages were done on an earlier visit."""
        return len(self.before) == len(STAGES)

    def rely_on_stop(self, context: StepContext) -> None:
        """Require a recent depth stop reading before the insertion. Raises TOOL-007 if it is too old."""
        if self.stop_read_s is None:
            return
        try:
            require_recent(context, f"the depth stop for {self.trajectory}", self.stop_read_s)
        except ReadingTooOld:
            context.setting.memory.drop(WorkProgress)
            raise
        self.stop_read_s = None


def work_progress(context: StepContext) -> WorkProgress:
    """Resume interrupted work if its instrument is still inside, or else start with the depth stop set.

    If work was done there before, the operator chooses the stage to continue from. Raises PRO-002.
    """
    memory, instrument = context.setting.memory, context.workcell.master.instrument
    trajectory = context.trajectory
    work_so_far = memory.find(WorkProgress)
    if work_so_far is not None and work_so_far.trajectory == trajectory == instrument.inside:
        return work_so_far
    context.request_instrument_removal()
    journeys = context.workcell.master.history.journeys
    is_same_visit = work_so_far is not None and work_so_far.visit == (trajectory, journeys)
    earlier = work_so_far if is_same_visit else None
    if earlier is not None and len(earlier.done) == len(STAGES):  # interrupted when all was done
        return earlier
    before, set_before = _tasks_done(context), instrument.stages.stop_at(trajectory)
    if len(before) == len(STAGES):
        context.find(
            f"the work at {trajectory} was finished when the guide was there earlier; the guide "
            "was not watched then"
        )
        return WorkProgress(trajectory, DepthStop.model_validate(set_before), before, list(before))
    stop = set_depth_stop(context)
    work_so_far = WorkProgress(trajectory, stop, before, list(before), journeys=journeys)
    if earlier is not None:
        work_so_far.watched, work_so_far.pushed_mm = earlier.watched, earlier.pushed_mm
    work_so_far.stop_read_s = context.setting.clock.now_s()
    instrument.stages.record_stop(trajectory, work_so_far.stop.model_dump(mode="json"))
    memory.keep(work_so_far)
    context.progress(0.1, f"the depth stop for {trajectory} is set")  # nobody pushes the guide
    instrument.record_insertion(trajectory)
    return work_so_far


def describe_work(stages: WorkedStages, trajectory: str) -> str:
    """Describe the work done at a target, whether more may have been done, and what interrupted it."""
    known, interruption = stages.tasks_at(trajectory), stages.interruption_at(trajectory)
    done = [
        stage.done_statement if known[stage.task] else f"not yet confirmed: {stage.done_statement}"
        for stage in STAGES
        if stage.task in known
    ]
    more = (UNRECORDED,) if stages.is_doubted(trajectory) else ()
    why = "" if interruption is None else f"; interrupted: {interruption}"
    return ", ".join((*done, *more)) + why


def work_begun_elsewhere(engine: Engine) -> tuple[str, ...]:
    """Describe the work that has or may have begun at each unfinished target."""
    finished = engine.course.finished
    stages = engine.setting.workcell.master.instrument.stages
    return tuple(
        f"work {'has' if stages.tasks_at(name) else 'may have'} begun at {name}: "
        + describe_work(stages, name)
        for name in engine.order.trajectories
        if name not in finished and stages.may_have_begun(name)
    )


def _tasks_done(context: StepContext) -> tuple[str, ...]:
    """Ask where to continue earlier work and return the tasks that are not repeated."""
    stages, tasks = context.workcell.master.instrument.stages, [stage.task for stage in STAGES]
    trajectory = context.trajectory
    if not stages.may_have_begun(trajectory):
        return ()
    known, doubted = stages.tasks_at(trajectory), stages.is_doubted(trajectory)
    # The instrument is out, and goes in again whatever was done with it.
    first = next((number for number, task in enumerate(tasks) if not known.get(task)), len(tasks) - 1)
    first = min(first, len(tasks) - 1)
    finished = all(known.get(task) for task in tasks) and stages.stop_at(trajectory) is not None
    later = tasks[first + 1 :] if doubted else []  # after what the journal supports
    offered = {stage_answer(task): task for task in (*reversed(tasks[: first + 1]), *later)}
    question = WORK_BEGUN.question(
        f"work {'was already' if known else 'may already have been'} begun at {trajectory}: "
        + describe_work(stages, trajectory),
        f"{BESIDE}; check, then choose the stage to continue from",
        trajectory,
        (*((FINISHED,) if finished else ()), *offered, HOLD_GUIDE),
    )
    answer = context.choose(question)
    if finished and answer == FINISHED:
        return tuple(tasks)
    if answer not in offered:
        raise NotConfirmed(
            f"nobody chose the stage to continue from at {trajectory}",
            action=f"Nothing was done. Repeat the step, or send {context.workcell.phrases.arms} home.",
        )
    return tuple(tasks[: tasks.index(offered[answer])])


class DepthStop(Values):
    """Computed setting and reading of the depth stop."""

    bore_mm: float = Field(description="Length of the guide's bore.")
    standoff_mm: float = Field(description="From the entry to the lower end of the guide.")
    depth_mm: float = Field(description="From the entry to the target.")
    computed_mm: float = Field(description="From the instrument's tip to the stop: the sum of these.")
    read_mm: float = Field(description="As read off the instrument.")

    @property
    def too_deep_mm(self) -> float:
        """How far (mm) beyond the target the depth stop reading reaches; negative if it falls short."""
        return self.read_mm - self.computed_mm


def set_depth_stop(context: StepContext) -> DepthStop:
    """Request, read and confirm the depth stop setting. Raises PRO-002, or TOOL-004 if it stays wrong."""
    checked, bore = context.result(CheckedPlan), context.workcell.tools.guide.bore
    plan, planned = checked.plan, checked.trajectory(context.trajectory)
    computed_mm = depth_stop_mm(plan, planned, bore)
    sum_text = (
        f"bore {bore.length_mm:.2f} + stand-off {plan.standoff_mm:.2f} + depth {planned.depth_mm:.2f}"
        f" = {computed_mm:.2f} mm from tip to stop"
    )
    task = Task(
        DEPTH_STOP,
        f"set the depth stop of the instrument for {context.trajectory} to {computed_mm:.2f} mm",
        context.trajectory,
        (computed_mm,),
        ("depth stop in mm, read off its scale",),
        (bore.length_mm, plan.instrument_length_mm),  # the part of its scale beyond the guide
    )
    for setting in range(1, SETTINGS + 1):
        (read_mm,) = context.perform_task(task)
        if abs(read_mm - computed_mm) <= STOP_LIMIT_MM:
            break
        problem = DEPTH_STOP_WRONG(
            f"the depth stop for {context.trajectory} is set wrong",
            expected=f"{computed_mm:.2f} mm",
            limit=f"{STOP_LIMIT_MM:g} mm from it",
            got=f"{read_mm:.2f} mm",
        )
        context.find(problem.summary)
        question = WRONG_STOP.question(
            "The depth stop is set wrong. Set it again?",
            f"read {read_mm:.2f} mm, expected {computed_mm:.2f} ± {STOP_LIMIT_MM:g} mm: {sum_text}; "
            f"{YES}: set and read it again, attempt {setting + 1} of {SETTINGS}; {NO}: the step ends, "
            "no instrument is inserted",
            context.trajectory,
        )
        if setting == SETTINGS or context.choose(question) != YES:
            raise problem
    context.confirm(
        Topic.DEPTH_STOP,
        f"Is the depth stop for {context.trajectory} set?",
        f"{sum_text}; read {read_mm:.2f} mm",
        context.trajectory,
    )
    return DepthStop(
        bore_mm=bore.length_mm,
        standoff_mm=plan.standoff_mm,
        depth_mm=planned.depth_mm,
        computed_mm=computed_mm,
        read_mm=read_mm,
    )
