"""Operator, room and clock of a replay: they repeat their recorded answers, and do nothing."""

from __future__ import annotations

from collections.abc import Sequence

from procedures.engine.errors import NotRecorded
from procedures.engine.replay.recorded_answers import RecordedAnswers
from procedures.journal.journal import Entry, Line
from procedures.operator.checkpoint import GO_ON
from procedures.operator.question import Question, Task, Topic

AT_CHECKPOINTS = (Topic.PAUSE, Topic.GUARD, Topic.HEAD_UNSEEN)  # nobody pauses a replay, and it has no guards


class RecordedOperator:
    """Answers as the journal has it, question by question."""

    def __init__(self) -> None:
        self._confirmations: list[tuple[int, Line]] = []  # after how many motions of the section

    def begin(self, section: Sequence[Line]) -> None:
        """From here on the answers are among these lines."""
        self._confirmations, motions = [], 0
        for line in section:
            motions += line["entry"] == Entry.MOTION
            if line["entry"] == Entry.CONFIRMATION:
                self._confirmations.append((motions, line))

    def asked_first_motion_after(self, motions: int) -> bool:
        """Whether the run's next question was for a first motion, after that many motions of the section."""
        for asked_after, line in self._confirmations:
            topic = str(line["topic"]).partition(":")[0]
            if topic not in AT_CHECKPOINTS:
                return topic == Topic.FIRST_MOTION and asked_after == motions
        return False

    def ask(self, question: Question) -> str:
        """The recorded answer to the next question of that name. Raises PRO-024 when it was not asked."""
        for place, (_, line) in enumerate(self._confirmations):
            if line["topic"] == question.name:
                del self._confirmations[: place + 1]
                return str(line["answer"])
        if question.topic is Topic.PAUSE:  # a guard asked in its place
            return GO_ON
        raise NotRecorded(f"the run did not ask {question.name}: {question.subject}")


class RecordedRoom:
    """Nobody hears, nobody changes tools: the controller's inputs are recorded, and what was read off."""

    def __init__(self) -> None:
        self._work: list[Line] = []

    def begin(self, work: Sequence[Line]) -> None:
        """From here on what hands did is among these lines."""
        self._work = list(work)

    def announce(self, step: str) -> None:
        """As `Room`."""

    def change_tool(self, number: int, description: str) -> None:
        """As `Room`."""

    def prepare_stand(self, holds: str) -> None:
        """As `Room`."""

    def work(self, task: Task) -> tuple[float, ...]:
        """What was read off after the next task of that name. Raises PRO-024 when it was not done."""
        for place, line in enumerate(self._work):
            if line["task"] == task.name:
                del self._work[: place + 1]
                readings = line["readings"]
                return tuple(map(float, readings)) if isinstance(readings, list) else ()
        raise NotRecorded(f"this was not done in the run: {task.subject}")


class RecordedClock:
    """The theatre time of the last answer; waiting takes none."""

    def __init__(self, answers: RecordedAnswers) -> None:
        self._answers = answers

    @property
    def paced(self) -> bool:
        return self._answers.opening.paced

    def now_s(self) -> float:
        return self._answers.moment_s

    def sleep(self, duration_s: float) -> None:
        """As `Clock`."""
