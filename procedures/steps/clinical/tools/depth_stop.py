"""The depth stop of the instrument: computed, set by hand, read off, and confirmed."""

from __future__ import annotations

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.journal.results import Values
from procedures.operator.question import NO, YES, Task, Topic
from procedures.planning.plan.guide_hold import depth_stop_mm
from procedures.steps.branches import SETTINGS, WRONG_STOP
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.errors import DepthStopWrong
from ronna_hw.wire.room_tasks import DEPTH_STOP

# A vernier has steps of 0.05 mm: beyond twice that it is set wrong.
STOP_LIMIT_MM = 0.1


class DepthStop(Values):
    """How the stop was computed, and what its scale showed."""

    bore_mm: float = Field(description="Length of the guide's bore.")
    standoff_mm: float = Field(description="From the entry to the lower end of the guide.")
    depth_mm: float = Field(description="From the entry to the target.")
    computed_mm: float = Field(description="From the instrument's tip to the stop: the sum of these.")
    read_mm: float = Field(description="As read off the instrument.")

    @property
    def too_deep_mm(self) -> float:
        """How much deeper than the target it lets the instrument go, as it was read."""
        return self.read_mm - self.computed_mm


def set_depth_stop(context: StepContext) -> DepthStop:
    """Have it set, read and confirmed; raises TOOL-004 when it does not come right, PRO-002."""
    checked, bore = context.result(CheckedPlan), context.workcell.tools.guide.bore
    plan, planned = checked.plan, checked.trajectory(context.trajectory)
    computed_mm = depth_stop_mm(plan, planned, bore)
    sum_of = (
        f"bore {bore.length_mm:.2f} + stand-off {plan.standoff_mm:.2f} + depth {planned.depth_mm:.2f}"
        f" = {computed_mm:.2f} mm from tip to stop"
    )
    task = Task(
        DEPTH_STOP,
        f"set the depth stop of the instrument for {context.trajectory} to {computed_mm:.2f} mm",
        context.trajectory,
        (computed_mm,),
        ("depth stop in mm, read off its scale",),
        (bore.length_mm, plan.instrument_length_mm),  # what the guide leaves of its scale
    )
    for setting in range(1, SETTINGS + 1):
        (read_mm,) = context.have_done(task)
        wrong = abs(read_mm - computed_mm) > STOP_LIMIT_MM
        if not wrong:
            break
        problem = DepthStopWrong(
            f"the depth stop for {context.trajectory} is set wrong",
            expected=f"{computed_mm:.2f} mm",
            limit=f"{STOP_LIMIT_MM:g} mm from it",
            got=f"{read_mm:.2f} mm",
        )
        context.find(problem.summary)
        question = WRONG_STOP.question(
            "the depth stop is set wrong: set it again",
            f"read {read_mm:.2f} mm, expected {computed_mm:.2f} ± {STOP_LIMIT_MM:g} mm: {sum_of}; "
            f"{YES}: set and read it again, attempt {setting + 1} of {SETTINGS}; {NO}: the step ends, "
            "no instrument is inserted",
            context.trajectory,
        )
        if setting == SETTINGS or context.choose(question) != YES:
            raise problem
    context.confirm(
        Topic.DEPTH_STOP,
        f"the depth stop for {context.trajectory} is set",
        f"{sum_of}; read {read_mm:.2f} mm",
        context.trajectory,
    )
    return DepthStop(
        bore_mm=bore.length_mm,
        standoff_mm=plan.standoff_mm,
        depth_mm=planned.depth_mm,
        computed_mm=computed_mm,
        read_mm=read_mm,
    )
