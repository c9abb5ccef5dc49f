"""Questions of a case, step by step, and who may answer each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from procedures.engine.order import Scope
from procedures.operator.question import FOR_A_PERSON, Topic, join_answers
from procedures.planning.plan_model import FiducialKind
from procedures.reporting.run_options import RunOptions
from procedures.steps.branches import BRANCHES, HOLD, KEPT_BASES, LEAVE_OUT, SPHERE_COUNT, UNREACHABLE
from procedures.steps.catalogue import AFTER_STOP, ANSWER_WORDS, clinical_steps
from ronna_hw.roles import ASSISTANT

NO_STRATEGY = (LEAVE_OUT, HOLD)  # of a trajectory out of reach, where there is no other way to look
PERSON, ANYBODY = "a person", "a person or the file of answers"
SUBJECTS: Mapping[Topic, str] = {
    Topic.PATIENT: "right patient, right plan; the identifier on the wristband is typed",
    Topic.RESUME: "the arm's present position becomes its home, if it was left elsewhere",
    Topic.HEAD_CLAMPED: "head clamped, clamp locked to the table, spheres or patient's frame on",
    Topic.SCANNED: "scan of the head as it is clamped now",
    Topic.CART_LOCKED: "brakes set; leaned on from each side; everyone stands clear",
    Topic.REGISTRATION: "registration, with the predicted error against the accepted one",
    Topic.PARK: "the way home",
    Topic.TOOL_CHANGE: "the tool has been exchanged",
    Topic.TOOL_TIP: "the tip calibration in use",
    Topic.TOOL_CHECK: "the way to the gauge",
    Topic.INSTRUMENT_OUT: "instrument or mandrel out of patient and guide",
    Topic.APPROACH: "the way over the entry and down to the stand-off",
    Topic.DEPTH_STOP: "the depth stop as read",
    Topic.SKIN: "skin open",
    Topic.DRILL: "skull drilled",
    Topic.BREAKTHROUGH: "the opening, where the drill's breakthrough is not where the CT has it",
    Topic.DURA: "dura open",
    Topic.AT_TARGET: "instrument at depth, work there done",
    Topic.RETREAT: "the way out along the axis",
    Topic.CALIBRATION: "the motions that measure one arm against the other",
    Topic.FIRST_MOTION: AFTER_STOP,
}


@dataclass(frozen=True)
class QuestionRow:
    """A question as the sheet lists it. The first answer goes on, the last counts for silence."""

    step: str  # what it does; empty if it is the step of the row before
    subject: str
    answers: str
    by: str

    @property
    def is_personal(self) -> bool:
        """Whether nobody but a person may answer on real devices."""
        return self.by == PERSON


def questions_of_course(
    roles: Sequence[str], fiducials: FiducialKind, *, measure_targets: bool, intraoperative: bool
) -> tuple[QuestionRow, ...]:
    """List the questions that every case asks, in order."""
    rows: list[QuestionRow] = []
    steps = clinical_steps(
        measure_targets=measure_targets, intraoperative=intraoperative, roles=roles, fiducials=fiducials
    )
    for step in steps:
        title = f"{step.title}, at each target" if step.scope is not Scope.CASE else step.title
        for topic in step.asks:
            rows.append(_row(title, topic, SUBJECTS.get(topic, topic.replace("_", " "))))
            title = ""
    return tuple(rows)


def questions_of_branches(roles: Sequence[str], fiducials: FiducialKind) -> tuple[QuestionRow, ...]:
    """List the questions that are asked only if something happens, and the confirmation of a first motion."""
    steps = {step.name for step in clinical_steps(roles=roles, fiducials=fiducials)}
    first = _row("", Topic.FIRST_MOTION, SUBJECTS[Topic.FIRST_MOTION])
    without_spheres = fiducials is FiducialKind.SURFACE
    branches = (
        _row("", branch.topic, branch.event, NO_STRATEGY if branch is UNREACHABLE and without_spheres else ())
        for branch in BRANCHES
        if branch.topic is not None
        and (not branch.steps or steps.intersection(branch.steps))
        and (branch is not KEPT_BASES or ASSISTANT in roles)
        and not (branch is SPHERE_COUNT and without_spheres)
    )
    return (first, *branches)


def _row(step: str, topic: Topic, subject: str, answers: Sequence[str] = ()) -> QuestionRow:
    by = PERSON if topic in FOR_A_PERSON or topic is Topic.PATIENT else ANYBODY
    return QuestionRow(step, subject, join_answers(answers or ANSWER_WORDS[topic]), by)


def describe_answering(options: RunOptions, *, simulated: bool) -> str:
    """Say in one sentence who answers in the theatre of a run."""
    has_file, asks = bool(options.values.get("answers")), bool(options.values.get("ask"))
    if not simulated:
        rest = "; its file of answers answers what the table allows" if has_file else ""
        return f"Real devices: a person answers at the terminal or from the console's seat{rest}."
    if asks:
        return "Rehearsal: a person answers everything, and does the manual work by a word."
    script = "a file of answers and a script answer" if has_file else "a script answers"
    return f"Rehearsal: {script}, or with --ask a person; on real devices it is a person."
