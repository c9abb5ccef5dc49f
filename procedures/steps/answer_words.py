"""The words that can answer each topic of a case."""

from __future__ import annotations

from procedures.operator.checkpoint import ABORT, GO_ON, LEAVE, WAIT
from procedures.operator.question import NO, NOBODY, READ, YES, Topic
from procedures.steps.branches import BRANCHES
from procedures.steps.clinical.at_target import DONE, HOLD
from procedures.steps.clinical.tools.begun_work import STAGES

ANSWER_WORDS: dict[Topic, tuple[str, ...]] = {
    **dict.fromkeys(Topic, (YES, NO)),
    **{branch.topic: branch.answers for branch in BRANCHES if branch.topic is not None},
    Topic.PAUSE: (GO_ON, ABORT),
    Topic.GUARD: (WAIT, LEAVE),
    Topic.READING: (READ, NOBODY),
    **{stage.topic: (DONE, HOLD) for stage in STAGES},
}
