"""What a coming step may ask, with the words that answer it: by its declaration and the table of branches."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.engine.order import StepSpec
from procedures.journal.results import StepResult
from procedures.operator.question import Topic, words
from procedures.steps.answer_words import ANSWER_WORDS
from procedures.steps.branches import BRANCHES

AFTER_STOP = "the arm has not moved since it was connected or stopped"


@dataclass(frozen=True)
class PlannedQuestion:
    """A question by its topic, and what must have happened for it; empty where it belongs to the course."""

    topic: Topic
    condition: str = ""

    @property
    def answers(self) -> tuple[str, ...]:
        """The first goes on, the last is what silence means."""
        return ANSWER_WORDS[self.topic]

    def __str__(self) -> str:
        return f"{self.topic}: {words(self.answers)}{f', if {self.condition}' if self.condition else ''}"


def planned_questions(spec: StepSpec[StepResult]) -> tuple[PlannedQuestion, ...]:
    """Those of its course in their order, then those of its branches; not what any step may meet."""
    course = [PlannedQuestion(topic) for topic in spec.asks]
    if spec.moves:
        course.append(PlannedQuestion(Topic.FIRST_MOTION, AFTER_STOP))
    branches = [
        PlannedQuestion(branch.topic, branch.event)
        for branch in BRANCHES
        if branch.topic is not None and spec.name in branch.steps and branch.topic not in spec.asks
    ]
    return (*course, *branches)
