"""Asks the operator, and has every question and its answer in the journal and in the stream of events."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from time import monotonic

from procedures.engine.events import Answered, EventStream, Questioned
from procedures.journal.journal import Entry, Journal
from procedures.operator.question import Operator, Question, Signature


def as_shown(question: Question, number: int) -> Questioned:
    """A question as shown to followers of the case."""
    return Questioned(
        question=number,
        topic=question.name,
        subject=question.subject,
        value=question.value,
        answers=question.answers,
        timeout_s=question.timeout_s,
        evidence=question.evidence,
        read_back=None if question.read_back is None else question.read_back.what,
        reads=question.reads,
        deliberate=question.deliberate,
    )


class Questions:
    """The way to ask in a case."""

    def __init__(
        self, operator: Operator, journal: Journal, now_s: Callable[[], float], events: EventStream
    ) -> None:
        """`now_s` is the theatre's time."""
        self._operator = operator
        self._journal = journal
        self._now_s = now_s
        self._events = events
        self._count = 0
        self.unanswered_s: float | None = None  # the time limit in which the last question had no answer

    def ask(self, question: Question) -> str:
        """The operator's answer; anything that is none of the question's answers counts as silence."""
        self._count += 1
        asked_s, began_s = self._now_s(), monotonic()
        self._events.publish(as_shown(question, self._count))
        signatures: list[Signature] = []
        numbered = replace(
            question, number=self._count, misread=lambda: self._misread(question), signed=signatures.append
        )
        try:
            answer = self._operator.ask(numbered)
            if answer not in question.answers:
                answer = question.silence
            limit_s = question.timeout_s
            self.unanswered_s = limit_s if limit_s is not None and monotonic() - began_s >= limit_s else None
            signed = asdict(signatures[-1]) if signatures else {}
            self._journal.write(
                Entry.CONFIRMATION,
                self._now_s(),
                topic=question.name,
                subject=question.subject,
                value=question.value,
                answer=answer,
                **signed,
                asked_s=asked_s,
            )
        except BaseException:  # nobody answers it any more, or its answer is not kept and does not count
            self._events.publish(Answered(question=numbered.number, answer=""))
            raise
        self._events.publish(Answered(question=numbered.number, answer=answer, by=signed.get("by", "")))
        return answer

    def _misread(self, question: Question) -> None:
        """An attempt that failed, without what was typed: it may be another patient's."""
        self._journal.write(Entry.MISREAD, self._now_s(), topic=question.name, subject=question.subject)
