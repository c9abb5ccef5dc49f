"""Work through the guide that was begun: what was done, and from which stage it continues."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.steps.branches import FINISHED, HOLD, WORK_BEGUN, from_stage
from procedures.steps.clinical.tools.depth_stop import DepthStop, set_depth_stop
from procedures.steps.errors import ReadingTooOld
from procedures.steps.reading_age import require_recent
from ronna_hw.wire import room_tasks

BESIDE = "the guide was repositioned since; its axis may miss the opening"


@dataclass(frozen=True)
class WorkStage:
    """One stage of the work through the guide: what hands do, and what is confirmed then."""

    task: str
    topic: Topic
    does: str
    confirms: str


STAGES = (
    WorkStage(room_tasks.SKIN, Topic.SKIN, "open the skin", "the skin is open"),
    WorkStage(room_tasks.DRILL, Topic.DRILL, "drill the skull", "the skull is drilled"),
    WorkStage(room_tasks.DURA, Topic.DURA, "open the dura", "the dura is open"),
    WorkStage(
        room_tasks.INSERT,
        Topic.AT_TARGET,
        "insert the instrument until its stop rests on the guide",
        "the instrument is at depth and the work there is done",
    ),
)


@dataclass
class BegunWork:
    """What was done through the guide, so that it continues there if the step was left.

    `before` are the tasks of stages that were done when the guide was led there earlier, and are not again.
    `watched` says that the tracker saw the guide after each stage since, `pushed_mm` how far it was from its
    place after one at most. `stop_read_s` is the theatre time at which the depth stop was read, until the
    instrument goes in by it.
    """

    trajectory: str
    stop: DepthStop
    before: tuple[str, ...] = ()
    done: list[str] = field(default_factory=list)  # tasks
    watched: bool = True
    pushed_mm: float = 0.0
    stop_read_s: float | None = None

    @property
    def finished_before(self) -> bool:
        """Whether nothing remained to be done."""
        return len(self.before) == len(STAGES)

    def rely_on_stop(self, context: StepContext) -> None:
        """The instrument goes in. Raises TOOL-007 when its stop was read too long ago: it is set anew."""
        if self.stop_read_s is None:
            return
        try:
            require_recent(context, f"the depth stop for {self.trajectory}", self.stop_read_s)
        except ReadingTooOld:
            context.setting.memory.drop(BegunWork)
            raise
        self.stop_read_s = None


def begun_work(context: StepContext) -> BegunWork:
    """What was begun and left with the instrument inside; otherwise new work, with the depth stop set.

    If work was done there before, the operator chooses the stage to continue from; raises PRO-002 otherwise.
    """
    memory, instrument = context.setting.memory, context.workcell.instrument
    trajectory = context.trajectory
    begun = memory.find(BegunWork)
    if begun is not None and begun.trajectory == trajectory == instrument.inside:
        return begun
    context.have_instrument_out()
    before, set_before = _done_before(context), instrument.stages.stop_at(trajectory)
    if len(before) == len(STAGES):
        context.find(
            f"the work at {trajectory} was finished when the guide was there earlier; the guide "
            "was not watched then"
        )
        return BegunWork(trajectory, DepthStop.model_validate(set_before), before, list(before))
    begun = BegunWork(trajectory, set_depth_stop(context), before, list(before))
    begun.stop_read_s = context.setting.clock.now_s()
    instrument.stages.stop_is_set(trajectory, begun.stop.model_dump(mode="json"))
    memory.keep(begun)
    context.progress(0.1, f"the depth stop for {trajectory} is set")  # nobody pushes the guide
    instrument.goes_in(trajectory)
    return begun


def done_in_words(known: Mapping[str, bool]) -> str:
    """What was done there, in words."""
    stages = [stage for stage in STAGES if stage.task in known]
    return ", ".join(
        stage.confirms if known[stage.task] else f"begun and not confirmed: {stage.does}" for stage in stages
    )


def begun_elsewhere(engine: Engine) -> tuple[str, ...]:
    """In words, where hands have worked through the guide and the target is not finished."""
    finished = engine.course.finished
    stages = engine.setting.workcell.instrument.stages
    names = [name for name in engine.order.trajectories if name not in finished and stages.at(name)]
    return tuple(f"work has begun at {name}: {done_in_words(stages.at(name))}" for name in names)


def _done_before(context: StepContext) -> tuple[str, ...]:
    """The tasks that are not done again; all of them where nothing remains but to say so."""
    stages, tasks = context.workcell.instrument.stages, [stage.task for stage in STAGES]
    if not (known := stages.at(context.trajectory)):
        return ()
    # The instrument is out: however far it was, it goes in again.
    first = next((number for number, task in enumerate(tasks) if not known.get(task)), len(tasks) - 1)
    first = min(first, len(tasks) - 1)
    finished = all(known.get(task) for task in tasks) and stages.stop_at(context.trajectory) is not None
    trajectory, offered = context.trajectory, [from_stage(task) for task in reversed(tasks[: first + 1])]
    question = WORK_BEGUN.question(
        f"work was already begun at {trajectory}: {done_in_words(known)}",
        f"{BESIDE}; check, then choose the stage to continue from",
        trajectory,
        (*((FINISHED,) if finished else ()), *offered, HOLD),
    )
    answer = context.choose(question)
    if finished and answer == FINISHED:
        return tuple(tasks)
    if answer not in offered:
        raise NotConfirmed(
            f"nobody chose the stage to continue from at {trajectory}",
            action="Nothing was done. Repeat the step, or send the arm home.",
        )
    return tuple(tasks[: len(offered) - 1 - offered.index(answer)])
