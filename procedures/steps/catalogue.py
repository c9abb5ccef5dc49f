"""Clinical steps in case order, with the questions that each may ask.

A new step is a new module and an entry here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from procedures.engine.methods import HeadStart
from procedures.engine.order import Steps, StepSpec
from procedures.journal.results import StepResult
from procedures.operator.checkpoint import ABORT, CONTINUE, LEAVE, WAIT
from procedures.operator.question import NO, NOBODY, READ, YES, Topic, join_answers
from procedures.planning.plan_model import FiducialKind
from procedures.steps.branches import BRANCHES
from procedures.steps.clinical import (
    at_target,
    cart_lock,
    confirmation,
    correspondence,
    ct_import,
    fiducial_localization,
    global_localization,
    head_clamp,
    intraoperative_scan,
    path_check,
    plan_check,
    positioning,
    registration,
    relocalization,
    retreat,
    set_up,
    target_measurement,
    tool_change,
    tool_check,
)
from procedures.steps.clinical.at_target import STAGE_ANSWERS
from procedures.steps.clinical.surface import (
    head_measurement,
    skin_in_ct,
    surface_paths,
    surface_registration,
    surface_scan,
    surface_start,
    surface_survey,
)
from procedures.steps.clinical.two_arms import base_to_base
from procedures.steps.clinical.work_progress import STAGES
from ronna_hw.roles import ASSISTANT, ONE_ARM

CLINICAL_STEPS: Steps = (
    ct_import.STEP,
    fiducial_localization.STEP,
    plan_check.STEP,
    set_up.STEP,
    head_clamp.STEP,
    cart_lock.STEP,
    global_localization.IN_CASE,
    correspondence.STEP,
    path_check.STEP,
    relocalization.STEP,
    registration.STEP,
    tool_change.STEP,
    tool_check.STEP,
    positioning.STEP,
    at_target.STEP,
    retreat.STEP,
    confirmation.STEP,
)
ANSWER_WORDS: dict[Topic, tuple[str, ...]] = {
    **dict.fromkeys(Topic, (YES, NO)),
    **{branch.topic: branch.answers for branch in BRANCHES if branch.topic is not None},
    Topic.PAUSE: (CONTINUE, ABORT),
    Topic.GUARD: (WAIT, LEAVE),
    Topic.READING: (READ, NOBODY),
    **{stage.topic: STAGE_ANSWERS for stage in STAGES},
}
AFTER_STOP = "the arm has not moved since it was connected or stopped"


# What each arm's work adds to a case of one arm: the steps that take the place of one.
BY_ROLE: Mapping[str, Mapping[StepSpec[StepResult], Steps]] = {
    ASSISTANT: {
        path_check.STEP: (path_check.STEP, base_to_base.STEP),
        at_target.STEP: (at_target.WITH_ASSISTANT,),
    }
}
MEASURING_TARGETS: Mapping[StepSpec[StepResult], Steps] = {
    tool_change.STEP: (target_measurement.STEP, tool_change.STEP)
}
SCANNING: Mapping[StepSpec[StepResult], Steps] = {
    head_clamp.STEP: (head_clamp.STEP, intraoperative_scan.STEP)
}
# Of a case that registers on the skin, with or without spheres: the same steps, which look at both.
ON_SKIN: Mapping[StepSpec[StepResult], Steps] = {
    path_check.STEP: (surface_paths.STEP,),
    relocalization.STEP: (surface_scan.STEP,),
    registration.STEP: (surface_registration.STEP,),
}
STARTS_ON_SKIN: Mapping[HeadStart, Mapping[StepSpec[StepResult], Steps]] = {
    HeadStart.LANDMARKS: {correspondence.STEP: (surface_start.STEP,)},
    HeadStart.SCAN: {correspondence.STEP: (head_measurement.STEP, surface_survey.STEP)},
}
BY_FIDUCIALS: Mapping[FiducialKind, Mapping[StepSpec[StepResult], Steps]] = {
    FiducialKind.SURFACE: {fiducial_localization.STEP: (skin_in_ct.STEP,), **ON_SKIN},
    FiducialKind.MIXED: {
        fiducial_localization.STEP: (fiducial_localization.STEP, skin_in_ct.WITH_SPHERES),
        **ON_SKIN,
    },
}


def clinical_steps(
    *,
    measure_targets: bool = False,
    intraoperative: bool = False,
    roles: Sequence[str] = ONE_ARM,
    fiducials: FiducialKind = FiducialKind.FREE,
    start: HeadStart = HeadStart.LANDMARKS,
) -> Steps:
    """Return the steps of a case with arms in these roles.

    On request it measures the targets, or scans the clamped head. What it registers is by the `fiducials`,
    and how it comes to the skin by the `start`.
    Raises ValueError where two changes replace the same step.
    """
    changes = [BY_ROLE.get(role, {}) for role in roles]
    changes += [MEASURING_TARGETS] * measure_targets + [SCANNING] * intraoperative
    changes.append(BY_FIDUCIALS.get(fiducials, {}))
    if fiducials.has_skin:
        changes.append(STARTS_ON_SKIN[start])
    replaced = {step: steps for change in changes for step, steps in change.items()}
    if len(replaced) < sum(map(len, changes)):
        raise ValueError(f"two of {', '.join(roles)} and the measurement of targets replace the same step")
    steps = tuple(one for step in CLINICAL_STEPS for one in replaced.get(step, (step,)))
    return _with_stand_ins(steps)


def name_every_step() -> Mapping[str, StepSpec[StepResult]]:
    """Return the steps of all cases by their names, whatever arms, options and fiducials these have."""
    on_skin = (*BY_FIDUCIALS.values(), *STARTS_ON_SKIN.values())
    changes = (*BY_ROLE.values(), MEASURING_TARGETS, SCANNING, *on_skin, {})
    return {
        one.name: one for step in CLINICAL_STEPS for change in changes for one in change.get(step, (step,))
    }


def _with_stand_ins(steps: Steps) -> Steps:
    """Let each step read, for a result, the one of a step in between that stands in for it."""
    found: list[StepSpec[StepResult]] = []
    for step in steps:
        made = [one.result for one in found]
        reads = tuple(
            next((one for one in reversed(made) if issubclass(one, model)), model) for model in step.reads
        )
        found.append(step if reads == step.reads else replace(step, reads=reads))
    return tuple(found)


@dataclass(frozen=True)
class PlannedQuestion:
    """Topic of a question, and the condition under which it is asked (empty if always)."""

    topic: Topic
    condition: str = ""

    @property
    def answers(self) -> tuple[str, ...]:
        """Possible answers: the first continues, the last is assumed on silence."""
        return ANSWER_WORDS[self.topic]

    def __str__(self) -> str:
        return (
            f"{self.topic}: {join_answers(self.answers)}{f', if {self.condition}' if self.condition else ''}"
        )


def list_questions(spec: StepSpec[StepResult]) -> tuple[PlannedQuestion, ...]:
    """Return a step's own questions: those of its normal course in order, then those of its branches."""
    course = [PlannedQuestion(topic) for topic in spec.asks]
    if spec.moves_an_arm:
        course.append(PlannedQuestion(Topic.FIRST_MOTION, AFTER_STOP))
    branches = [
        PlannedQuestion(branch.topic, branch.event)
        for branch in BRANCHES
        if branch.topic is not None and spec.name in branch.steps and branch.topic not in spec.asks
    ]
    return (*course, *branches)
