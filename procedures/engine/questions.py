"""Questions to the operator and tasks of the theatre staff, recorded in journal and events."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from time import monotonic

from procedures.engine.events import Answered, EventStream, Questioned
from procedures.engine.setting import CaseSetting
from procedures.journal.journal import Entry, Journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Answer, Question, Task, Topic
from procedures.workcell.arm_history import HeldInstrument
from ronna_hw.wire.room_tasks import EMPTY, OUT, REST_DRILL

IS_OUT, INSIDE = "out", "inside"
# In place of a trajectory: where the mandrel is while the guide is checked or its tip calibrated.
IN_GAUGE, IN_DIVOT = "the gauge", "the divot"


def as_shown(question: Question, number: int) -> Questioned:
    """Convert a question to the event that is shown to followers."""
    return Questioned(
        question=number,
        topic=question.name,
        subject=question.subject,
        value=question.value,
        answers=question.answers,
        timeout_s=question.timeout_s,
        evidence=question.evidence,
        predicted=question.predicted,
        pictures=question.pictures,
        identity=question.identity,
        identity_sha256="" if question.identity is None else question.identity.sha256,
        read_back=None if question.read_back is None else question.read_back.what,
        emphasis="" if question.read_back is None else question.read_back.shown,
        reads=question.reads,
        deliberate=question.deliberate,
    )


class Questions:
    """Questions and tasks of a case, with recording of answers and readings."""

    def __init__(self, setting: CaseSetting, journal: Journal, events: EventStream) -> None:
        self._setting = setting
        self._journal = journal
        self._events = events
        self._count = 0
        self.signed_answers = 0  # given by a named person
        self.unanswered_s: float | None = None  # the time limit that the last question exceeded

    def ask(self, question: Question) -> Answer:
        """Ask the operator and return the answer. An invalid word counts as silence."""
        self._count += 1
        asked_s, began_s = self._setting.clock.now_s(), monotonic()
        self._events.publish(as_shown(question, self._count))
        numbered = replace(question, number=self._count, misread=lambda: self._misread(question))
        try:
            answer = self._setting.operator.ask(numbered)
            if answer.word not in question.answers:
                answer = Answer(question.silence)
            limit_s = question.timeout_s
            self.unanswered_s = limit_s if limit_s is not None and monotonic() - began_s >= limit_s else None
            signed = {} if answer.signature is None else asdict(answer.signature)
            self.signed_answers += bool(signed)
            self._journal.write(
                Entry.CONFIRMATION,
                self._setting.clock.now_s(),
                topic=question.name,
                subject=question.subject,
                value=question.value,
                answer=answer.word,
                **signed,
                asked_s=asked_s,
            )
        except BaseException:  # nobody answers any more, or the answer was not recorded and does not count
            self._events.publish(Answered(question=numbered.number, answer=""))
            raise
        self._events.publish(Answered(question=numbered.number, answer=answer.word, by=signed.get("by", "")))
        return answer

    def ask_in_time(self, question: Question) -> str:
        """Ask the operator and return the word. Raises PRO-002 if it counts as an answer that nobody gave."""
        answer = self.ask(question)
        reason = answer.silence_reason
        if answer.word == question.silence and (late_s := self.unanswered_s) is not None:
            reason = f"no answer within {late_s:g} s{f' ({reason})' if reason else ''}"
        if reason:
            raise NotConfirmed(
                f"{reason} to '{question.subject}'",
                action="Nothing was done; the step asks again when it is repeated.",
            )
        return answer.word

    def _misread(self, question: Question) -> None:
        """Record a failed read-back without the typed text, which may identify another patient."""
        self._journal.write(
            Entry.MISREAD, self._setting.clock.now_s(), topic=question.name, subject=question.subject
        )

    def perform_task(self, task: Task) -> tuple[float, ...]:
        """Assign a task and return its readings. Raises PRO-002 if any are missing or not finite."""
        began_s = self._setting.clock.now_s()
        readings = self._setting.room.work(task)
        if not all(map(math.isfinite, readings)):  # no limit rejects what is no number
            raise NotConfirmed(
                f"the readings are not finite numbers: {task.subject}",
                expected=", ".join(task.reads),
                got=str(readings),
            )
        self._journal.write(
            Entry.WORK,
            self._setting.clock.now_s(),
            task=task.name,
            subject=task.subject,
            trajectory=task.trajectory,
            readings=list(readings),
            began_s=began_s,
        )
        if len(readings) != len(task.reads):
            count_text = f"{len(readings)} of {len(task.reads)}" if readings else "no"
            raise NotConfirmed(
                f"{count_text} readings were given: {task.subject}", expected=", ".join(task.reads)
            )
        return readings

    def rest_drill(self) -> None:
        """Have a drill in the assistant's holder switched off, unless it is: it is not led out turning."""
        workcell = self._setting.workcell
        if (held := workcell.held_instrument) is not None and held.may_turn:
            self.perform_task(Task(REST_DRILL, resting_words(held), held.trajectory))
            workcell.record_drill_at_rest()

    def request_instrument_removal(self) -> None:
        """Have any instrument in the guide, and in the assistant's holder, removed, a drill at rest.

        Raises PRO-002 unless the operator confirms.
        """
        self.rest_drill()
        workcell = self._setting.workcell
        instrument, held = workcell.master.instrument, workcell.held_instrument
        if (place := instrument.inside) is None:
            if held is not None:
                self._empty_holder(held)
            return
        trajectory = None if place in (IN_GAUGE, IN_DIVOT) else place
        is_in_doubt = workcell.master.place.assumed
        look = "look whether one is there; if so, " if is_in_doubt else ""
        self.perform_task(Task(OUT, f"{look}{removal_words(place, held)}", trajectory))

        from_holder = "" if held is None else ", and out of the assistant's holder"
        asked = f"Is the {_instrument_name(place, held)} out of {place} and out of the guide{from_holder}?"
        if place == IN_DIVOT:
            asked = f"Is {place} lowered, and are hands clear of it and of the guide?"
        doubt = "the journal does not say whether one went in; " if is_in_doubt else ""
        self._require_out(
            asked,
            f"{doubt}nothing moves while it is inside; afterwards {workcell.phrases.arms} may move",
            trajectory,
            NotConfirmed(
                f"{_spoken(held)} is still in {place}: nothing moves",
                action=f"By hand, {removal_words(place, held)}; then repeat the step or send "
                f"{workcell.phrases.arms} home.",
            ),
        )
        instrument.record_removal()
        workcell.release_instrument()

    def _empty_holder(self, held: HeldInstrument) -> None:
        emptying = f"take the {held.name} out of the assistant's holder"
        self.perform_task(Task(EMPTY, emptying, held.trajectory))
        self._require_out(
            "Is the assistant's holder empty?",
            f"{_spoken(held)} may be in it; afterwards the assistant may move",
            held.trajectory,
            NotConfirmed(
                f"{_spoken(held)} is still in the assistant's holder",
                action=f"By hand, {emptying}; then repeat the step or send the arms home.",
            ),
        )
        self._setting.workcell.release_instrument()

    def _require_out(self, asked: str, value: str, trajectory: str | None, refusal: NotConfirmed) -> None:
        value = f"{value}: stand clear before you answer"
        answers = (IS_OUT, INSIDE)
        question = Question(Topic.INSTRUMENT_OUT, asked, value, answers, trajectory, timeout_s=None)
        if self.ask(question).word != IS_OUT:
            raise refusal


def resting_words(held: HeldInstrument) -> str:
    """Describe what is done by hand before a drill that may be turning is led out."""
    return f"switch the drill for {held.trajectory} off"


def removal_words(place: str, held: HeldInstrument | None = None) -> str:
    """Describe the manual work required before the arm may leave a place."""
    if place == IN_DIVOT:
        return f"lower {place} from the guide"
    return f"remove the {_instrument_name(place, held)} from {place} and from the guide"


def _instrument_name(place: str, held: HeldInstrument | None) -> str:
    if place == IN_GAUGE:
        return "mandrel"
    return "instrument" if held is None else held.name


def _spoken(held: HeldInstrument | None) -> str:
    return "an instrument" if held is None else f"{'a' if held.drill else 'an'} {held.name}"
