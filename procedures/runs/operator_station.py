"""Operator station at the console: one thread receives orders, the engine's thread executes them.

Only a stop reaches the arm from here. Everything else waits until the engine asks for it: between steps, at a
checkpoint or with a question.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from procedures.engine.events import Seat as SeatEvent
from procedures.engine.events.event_types import digest_of_question
from procedures.engine.questions import as_shown
from procedures.operator.checkpoint import ABORT
from procedures.operator.question import (
    MISREAD_REASON,
    MOST_MISREAD,
    Answer,
    Question,
    Signature,
    Topic,
    tries_left,
)
from procedures.runs import orders

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

LEASE_S = 10.0  # host time without a sign of life; a page renews each second
LOOK_AGAIN_S = 0.2  # host time between two looks at the seat while nothing happens
EMPTY_SEAT = "the operator's seat was empty"
NONCES_KEPT = 4096  # at the ten orders a second that the console lets through: seven minutes


class OperatorSeat:
    """Operator's seat: a lease claimed under a name and renewed periodically. Not thread-safe."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        """`now_s` returns host time in seconds."""
        self._now_s = now_s
        self._session = self._name = ""
        self._renewed_s = 0.0
        self.ever_taken = False

    @property
    def holder(self) -> str:
        """Name of the current holder; empty if the seat is free or its lease has expired."""
        return self._name if self._now_s() - self._renewed_s <= LEASE_S else ""

    @property
    def has_lapsed(self) -> bool:
        """Whether the seat is claimed but its lease has expired."""
        return bool(self._name) and not self.holder

    def claim(self, session: str, name: str) -> str:
        """Claim the seat; return the reason for a refusal, or an empty string."""
        if self.holder and session != self._session:
            return f"the seat is taken by {self.holder}"
        self._session, self._name, self._renewed_s = session, name, self._now_s()
        self.ever_taken = True
        return ""

    def is_held_by(self, session: str) -> bool:
        """Whether a session holds the seat."""
        return bool(self.holder) and session == self._session

    def renew(self, session: str) -> None:
        """Renew the lease if the session holds the seat."""
        if self.is_held_by(session):
            self._renewed_s = self._now_s()

    def free(self) -> None:
        """Free the seat."""
        self._session = self._name = ""


@dataclass(frozen=True)
class PendingOrder:
    """Order to be carried out between steps, with the person who gave it."""

    order: orders.Next | orders.RunTo | orders.Resume | orders.Abort | orders.Acknowledge
    by: str
    times_vacated: int = 0  # how often the seat had become free when it was given

    @property
    def aborts(self) -> bool:
        """Whether the order ends the case."""
        return isinstance(self.order, orders.Abort)


@dataclass
class _OpenQuestion:
    """An open question and, once given, its answer."""

    question: Question
    shown: str
    answer: Answer | None = None
    misread: int = 0  # how often a wrong value was read back
    misread_noted: int = 0  # of these, how many are in the journal
    acknowledged_by: str = ""  # who acknowledges faults while it stands


class OperatorStation:
    """The console operator as seen by the engine. Every method is thread-safe."""

    def __init__(self, *, waits: bool, now_s: Callable[[], float] = time.monotonic) -> None:
        """If `waits`, no step runs and no question is answered until someone takes the seat."""
        self._changed = threading.Condition()
        self._now_s = now_s
        self._seat = OperatorSeat(now_s)
        self.waits = waits  # until someone takes the seat
        self._engine: Engine | None = None
        self._waiting_for: str | None = None  # the upcoming step, while the engine waits between steps
        self._pending: PendingOrder | None = None
        self._question: _OpenQuestion | None = None
        self._nonces: deque[str] = deque(maxlen=NONCES_KEPT)
        self._taken: deque[tuple[str, str, float | None]] = deque()  # as `changes_of_seat`
        self._vacated = 0
        self._awaits_seat = False
        self._gone = False
        self._stopped = False  # and nobody in the seat has answered since

    def attach(self, engine: Engine) -> None:
        """Direct all further orders to an engine."""
        with self._changed:
            self._engine = engine
            if name := self._seat.holder:  # taken while the theatre was being opened
                engine.events.publish(SeatEvent(holder=name))

    def leave(self) -> None:
        """Mark the console as gone, so that the fallback operators take over."""
        with self._changed:
            self._gone = True
            self._seat.free()
            self._changed.notify_all()

    @property
    def in_charge(self) -> bool:
        """Whether the console is alive and its seat has been taken, or must be."""
        with self._changed:
            return not self._gone and (self.waits or self._seat.ever_taken)

    @property
    def stopped(self) -> bool:
        """Whether the arm was stopped from the console and no seated operator has answered since."""
        with self._changed:
            return self._stopped

    @property
    def waiting_for(self) -> str | None:
        """Upcoming step while the engine waits for an order between steps, else None."""
        with self._changed:
            return self._waiting_for

    @property
    def open_question(self) -> tuple[int, str] | None:
        """Number and digest of the open question, or None if no question is open."""
        with self._changed:
            current = self._question
            return None if current is None else (current.question.number, current.shown)

    @property
    def is_awaiting_person(self) -> bool:
        """Whether the engine waits for somebody to take the seat, to order or to answer.

        It takes no lock: a signal handler asks for it.
        """
        return self._awaits_seat or self._waiting_for is not None or self._question is not None

    @property
    def gone(self) -> bool:
        """Whether the console has ended."""
        with self._changed:
            return self._gone

    def changes_of_seat(self) -> list[tuple[str, str, float | None]]:
        """Return all seat changes since the last call as (session, name, theatre time in s).

        Without a name the seat became free; the time is None before the theatre was open.
        """
        with self._changed:
            self._notice_lapse()
            changes = list(self._taken)
            self._taken.clear()
            return changes

    def free_silent_seat(self) -> None:
        """Free the seat if its lease has expired, even while the engine is busy."""
        with self._changed:
            self._notice_lapse()

    # The thread that reads orders

    def take(self, sent: orders.SentOrder) -> str:
        """Accept an order; return the reason for a refusal, or an empty string."""
        with self._changed:
            if sent.nonce in self._nonces:
                return "this order was already given"
            self._nonces.append(sent.nonce)
            self._notice_lapse()
            late = sent.expires_s is not None and self._now_s() > sent.expires_s
            if late and not isinstance(sent.order, orders.Stop):
                return "the order came too late"
            refused = self._find_refusal(sent) or self._follow(sent)
            self._changed.notify_all()
            return refused

    @property
    def _state(self) -> orders.CaseActivity:
        if self._engine is None:
            return orders.CaseActivity.OPENING
        topic = None if self._question is None else self._question.question.topic
        return orders.activity_of(topic, is_waiting=self._waiting_for is not None)

    def _find_refusal(self, sent: orders.SentOrder) -> str:
        """Return the reason for refusing an order in the current state, or an empty string."""
        rule, state = orders.RULE_OF[type(sent.order)], self._state
        if rule.seat and not self._seat.is_held_by(sent.session):
            return "you are not in the operator's seat"
        if state not in rule.from_console:
            if state is orders.OPENING:
                return "the theatre is not open yet"
            if state is orders.WAITING:
                return "no step is running"
            return "the engine is not waiting for an order: a step is running, or a question is open"
        if sent.upcoming is not None and sent.upcoming != self._waiting_for:
            return f"out of date: the next step is now {self._waiting_for}"
        return ""

    def _follow(self, sent: orders.SentOrder) -> str:
        session, name, order = sent.session, self._seat.holder, sent.order
        match order:
            case orders.Claim():
                if refused := self._seat.claim(session, order.name.strip()):
                    return refused
                self._tell_seat(session, order.name.strip())
            case orders.Renew():
                self._seat.renew(session)
            case orders.Release():
                self._vacate("the operator left the seat")
            case orders.Stop():
                return self._stop(session)
            case orders.AnswerQuestion():
                return self._answer(order, session)
            case _:
                assert self._engine is not None, (
                    "the rules let no other order pass before the theatre is open"
                )
                return self._steer(order, Signature(name, session, shown=""), self._engine)
        return ""

    def _steer(
        self,
        order: orders.Next | orders.RunTo | orders.Resume | orders.Pause | orders.Abort | orders.Acknowledge,
        by: Signature,
        engine: Engine,
    ) -> str:
        """Apply an order immediately, or store it until the engine waits between steps."""
        current, state = self._question, self._state
        match order:
            case orders.Pause():
                engine.checkpoint.pause(f"{by.by} asked for a pause")
                return ""
            case orders.Abort() if state is orders.PAUSED and current is not None and current.answer is None:
                self._settle(Answer(ABORT, signature=by))  # it quotes nothing
                return ""
            case orders.Abort() if state is not orders.WAITING:
                engine.checkpoint.abort()
                if current is not None:
                    self._settle(Answer(current.question.silence))
            case orders.Acknowledge() if current is not None:
                if current.answer is not None:
                    return "the pause is over"
                current.acknowledged_by = by.by
                return ""
            case orders.RunTo(step=step):
                if step not in map(str, engine.order.sequence):
                    return f"there is no step {step!r}"
                if refused := engine.course.why_not_up_to(engine.order.find(step)):
                    return refused
        self._pending = PendingOrder(order, by.by, self._vacated)
        return ""

    def _stop(self, session: str) -> str:
        engine = self._engine
        if engine is None:
            return "the theatre is not open yet: nothing moves"
        seated = self._seat.is_held_by(session)
        who = self._seat.holder if seated else f"someone outside the operator's seat (session {session})"
        self._stopped = True
        engine.checkpoint.pause(f"{who} stopped the arm", firm=True)
        threading.Thread(target=engine.setting.workcell.stop, name="stop now").start()
        return ""

    def _answer(self, order: orders.AnswerQuestion, session: str) -> str:
        current = self._question
        if current is None or current.question.number != order.question or current.answer is not None:
            return "that question is no longer open"
        question = current.question
        if order.shown != current.shown:
            return "the question shown is not the question asked"
        by = Signature(self._seat.holder, session, current.shown)
        answer = Answer(order.answer, order.typed, order.readings, by)
        if question.read_back is not None and question.is_misread(answer):
            if question.asks_for_help(answer):
                return f"type {question.read_back.what}"
            current.misread += 1
            wrong = f"{answer.typed!r} {question.read_back.wrong.rstrip('.')}"
            if current.misread < MOST_MISREAD:
                return f"{wrong}; {tries_left(current.misread)}"
            self._settle(Answer(question.silence, signature=by, silence_reason=MISREAD_REASON))
            return f"{wrong}; {MOST_MISREAD} wrong values count as {question.silence!r}"
        if refused := question.why_refused(answer):
            return refused
        if question.topic is Topic.PAUSE:
            self._stopped = False
        self._settle(answer)
        return ""

    def _settle(self, answer: Answer) -> None:
        if self._question is not None and self._question.answer is None:
            self._question.answer = answer

    def _notice_lapse(self) -> None:
        if self._seat.has_lapsed:
            self._vacate(f"the operator's page has not responded for {LEASE_S:g} s")

    def _vacate(self, reason: str) -> None:
        """Free the seat and cancel the pending order, unless it is an abort."""
        self._seat.free()
        self._vacated += 1
        if self._pending is not None and not self._pending.aborts:
            self._pending = None
        self._tell_seat("", "", reason)

    def _tell_seat(self, session: str, name: str, reason: str = "") -> None:
        since_s = None
        if self._engine is not None:
            since_s = self._engine.events.publish(SeatEvent(holder=name, reason=reason)).theatre_time_s
        self._taken.append((session, name, since_s))

    # The engine's own thread

    def ask(self, question: Question, acknowledge: Callable[[str], None] = lambda _by: None) -> Answer | None:
        """Wait for the console's answer; return silence after the time limit, None if the console is gone.

        At a pause, `acknowledge` is called with the name of the person who acknowledges faults.
        """
        ends_s = None if question.timeout_s is None else self._now_s() + question.timeout_s
        with self._changed:
            shown = digest_of_question(as_shown(question, question.number))
            self._question = current = _OpenQuestion(question, shown)
            try:
                while current.answer is None and not self._gone:
                    if not self._wait_until(ends_s):
                        reason = "" if self._seat.holder else EMPTY_SEAT
                        return Answer(question.silence, silence_reason=reason)
                    while current.misread_noted < current.misread:
                        current.misread_noted += 1
                        question.misread()
                    if current.acknowledged_by:
                        by, current.acknowledged_by = current.acknowledged_by, ""
                        self._changed.release()  # devices take seconds, and a stop must get through
                        try:
                            acknowledge(by)
                        finally:
                            self._changed.acquire()
            finally:
                self._question = None
        return current.answer

    def _wait_until(self, ends_s: float | None) -> bool:
        """Wait a moment for a change, unless this host time has come; return whether it has not."""
        remaining_s = LOOK_AGAIN_S if ends_s is None else min(LOOK_AGAIN_S, ends_s - self._now_s())
        if remaining_s > 0.0:
            self._changed.wait(remaining_s)
            self._notice_lapse()
        return remaining_s > 0.0

    def await_seat(self) -> None:
        """If the seat must be taken, wait until someone takes it or the console is gone."""
        with self._changed:
            try:
                while self.waits and not self._seat.holder and not self._gone:
                    self._awaits_seat = True
                    self._changed.wait(LOOK_AGAIN_S)
                    self._notice_lapse()
            finally:
                self._awaits_seat = False

    def next_order(self, upcoming: str, timeout_s: float | None = None) -> PendingOrder | None:
        """Wait between steps for an order; return None after the time limit or if the console is gone."""
        ends_s = None if timeout_s is None else self._now_s() + timeout_s
        with self._changed:
            self._waiting_for = upcoming
            try:
                while self._pending is None and not self._gone:
                    if not self._wait_until(ends_s):
                        return None
                order, self._pending = self._pending, None
                return order
            finally:
                self._waiting_for = None

    @property
    def aborting(self) -> bool:
        """Whether an abort of the case is pending."""
        with self._changed:
            return self._pending is not None and self._pending.aborts

    def is_occupied_since(self, times_vacated: int) -> bool:
        """Whether the seat is taken and has not been vacated since the count was `times_vacated`."""
        with self._changed:
            self._notice_lapse()
            return bool(self._seat.holder) and self._vacated == times_vacated
