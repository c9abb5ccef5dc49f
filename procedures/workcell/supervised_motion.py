"""Around every motion: a checkpoint before it, its intent and its result in the journal.

A motion that someone else stopped is asked about, and re-planned from the arm's present position. The first
motion since the arm was last stopped or its stream ended is confirmed by the operator.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from procedures.engine.checkpoint import Checkpoint
from procedures.engine.errors import NotConfirmed
from procedures.engine.journal import JournalValue
from procedures.engine.operator import YES, Question, Topic
from procedures.workcell.motion_facts import MotionFacts, in_sequence
from procedures.workcell.motion_log import MotionLog
from ronna_hw.devices.errors import MotionInterrupted
from ronna_hw.devices.readings import ArmReading

IN_WORDS = {
    "go": "to the next pose, via home if necessary",
    "home": "home",
    "back": "back the way the arm came",
    "step": "directly to the next pose",
    "settle": "to the next pose, each joint arriving from its own side",
    "line": "in a straight line",
    "insert": "along the axis to where the guide is held",
    "withdraw": "out along the axis",
}


class SupervisedMotion:
    """Carries motions out one after the other."""

    def __init__(self, log: MotionLog) -> None:
        self._log = log
        self._checkpoint: Checkpoint | None = None
        self._ask: Callable[[Question], str] | None = None
        self._confirmed = False  # the first motion

    def count_from(self, count: int) -> None:
        """As `MotionLog.count_from`."""
        self._log.count_from(count)

    def ask_before(self, checkpoint: Checkpoint, ask: Callable[[Question], str]) -> None:
        """From now on every motion meets that checkpoint, and the first one is asked about."""
        self._checkpoint, self._ask = checkpoint, ask

    def begin_anew(self) -> None:
        """The arm was stopped or its stream ended: the next motion is a first one again."""
        self._confirmed = False

    def confirm(
        self, topic: Topic, subject: str, motions: Sequence[MotionFacts], trajectory: str | None = None
    ) -> None:
        """Have motions confirmed, in two steps where a person answers; raises PRO-002 unless it is a yes."""
        read_back = motions[0].read_back if motions else None
        question = Question(topic, subject, in_sequence(motions), trajectory=trajectory, read_back=read_back)
        self._confirmed = self._require_yes(question) or self._confirmed

    def confirm_start(self, words: str) -> bool:
        """Have confirmed what a driver asks before the arm starts; False when there is nobody to ask.

        Raises PRO-002 unless the answer is yes.
        """
        self._confirmed = False
        return self._require_yes(Question(Topic.UNVERIFIED, "start the arm", words))

    def _require_yes(self, question: Question) -> bool:
        """False when there is nobody to ask; raises PRO-002 unless the answer is yes."""
        if self._ask is None:
            return False
        if self._ask(question) != YES:
            raise NotConfirmed(f"the operator did not confirm: {question.subject}", got=question.value)
        return True

    def carry_out(
        self,
        what: str,
        to: list[float],
        move: Callable[[], ArmReading],
        *,
        facts: Callable[[], MotionFacts],
        resume: Callable[[], None],
        trajectory: str | None = None,
        **more: JournalValue,
    ) -> ArmReading:
        """Carry out a motion to joints in rad or a position in mm; re-planned after a stop if the operator
        says so.

        `facts` says what it will do, for the question; `resume` takes the arm out of HOLD; `more` is written
        with its intent. Raises PRO-002, PRO-004, what a guard or a watch found, and what the motion raises.
        """

        checkpoint = self._checkpoint
        if checkpoint is None:
            raise NotConfirmed(f"nobody can confirm the motion {what!r}", expected="a case that is open")

        named = f"the motion {what!r}" + (f" ({IN_WORDS[what]})" if what in IN_WORDS else "")

        def watched() -> ArmReading:
            with checkpoint.watching(named, True):
                return move()

        while True:
            checkpoint.here(f"before {named}")
            if not self._confirmed:
                self.confirm(Topic.FIRST_MOTION, f"first motion: {what}", [facts()], trajectory)
            if not checkpoint.wanted:
                resume()
            if checkpoint.wanted:  # since the checkpoint, such as a stop while the question stood
                self._confirmed = False
                continue
            try:
                return self._log.record(what, to, watched, trajectory, **more)
            except MotionInterrupted:
                self._confirmed = False
                checkpoint.stopped(named, "re-plans it from the arm's present position")
