"""At the target: the arm rests; what the controller reports is compared with what was commanded."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.errors import GateFailed, NotConfirmed
from procedures.engine.operator import Question, Topic
from procedures.engine.result import FramedPose, StepResult
from procedures.engine.step import Outcome, Phase, Scope, StepSpec
from procedures.steps.clinical.conditions import inserted
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.room_check import head_must_show

POSITION_LIMIT_MM = 0.05  # nominal tip against the commanded one; more means the arm did not arrive
HOLD = "hold"  # the instrument stays where it is, and the case is held
STAYS = "The instrument stays on its target. Repeat the step, or send the arm home."
DONE = "done"  # the one word that ends the hold
DWELL_S = 0.5  # of theatre time, before the reading


class ReachedTarget(StepResult, kind="at_target"):
    """Where the tip is as far as the controller knows."""

    tool_pose: FramedPose = Field(description="Nominal pose robot <- tool at the measured joints.")
    nominal_error_mm: float = Field(description="Of that tip against the commanded one.")


def run(context: StepContext) -> Outcome[ReachedTarget]:
    """Read the arm at rest and record where the tip is as far as the controller knows."""
    commanded = context.result(PositionedGuide).tool_pose.transform
    context.setting.clock.sleep(DWELL_S)
    reached = context.workcell.tool_pose()
    error_mm = float(np.linalg.norm(reached.translation_mm - commanded.translation_mm))
    if error_mm > POSITION_LIMIT_MM:
        raise GateFailed(
            "the arm is not where it was sent", limit=f"{POSITION_LIMIT_MM} mm", got=f"{error_mm:.3f} mm"
        )
    question = Question(
        Topic.AT_TARGET,
        f"at {context.trajectory}: the arm holds until the work there is done",
        f"nominal tip {error_mm:.3f} mm from where it was sent",
        (DONE, HOLD),
        trajectory=context.trajectory,
        timeout_s=None,
    )
    with head_must_show(context):
        with context.watching(f"the hold at {context.trajectory}"):
            answer = context.choose(question)
        if answer != DONE:
            raise NotConfirmed(f"nobody said that the work at {context.trajectory} is done", action=STAYS)
        context.progress(1.0, f"the work at {context.trajectory} is done")
    return Outcome(
        ReachedTarget(tool_pose=FramedPose.of(reached), nominal_error_mm=error_mm),
        summary=f"nominal tip within {error_mm:.4f} mm of the command",
    )


STEP = StepSpec(
    ReachedTarget,
    "Hold at the target",
    Phase.OPERATION,
    run,
    scope=Scope.TRAJECTORY,
    reads=(PositionedGuide,),
    continues=True,
    preconditions=inserted,
)
