"""Where orders from the console meet the engine: taken by one thread, carried out by the engine's own.

Only a stop reaches the arm from here; everything else waits until the engine asks for it between steps, at a
checkpoint or with a question.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from procedures.cli.case.commands import why_not_up_to
from procedures.cli.console.seat import Seat
from procedures.engine.events import Seat as SeatEvent
from procedures.engine.events.shown import shown_digest
from procedures.engine.orders import (
    Abort,
    Acknowledge,
    AnswerQuestion,
    AnyOrder,
    Claim,
    Next,
    Pause,
    Release,
    Renew,
    Resume,
    RunTo,
    Stop,
)
from procedures.engine.questions import as_shown
from procedures.operator.checkpoint import ABORT
from procedures.operator.question import Question, Signature
from procedures.operator.room import misread
from procedures.operator.topic import Topic

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

LOOK_AGAIN_S = 0.2  # host time between two looks at the seat while nothing happens
NONCES_KEPT = 4096  # at the ten orders a second that the console lets through: seven minutes


@dataclass(frozen=True)
class Wish:
    """What to do between steps: `abort`, `acknowledge`, `next`, `to` a step, or run to the `end`."""

    what: str
    step: str = ""
    by: str = ""
    vacated: int = 0  # how often the seat had become free when it was given


@dataclass
class _Standing:
    """The open question."""

    question: Question
    shown: str
    answer: str | None = None
    signature: Signature | None = None
    readings: tuple[float, ...] | None = None
    misread: int = 0  # how often, not yet in the journal
    acknowledged_by: str = ""  # who acknowledges faults while it stands


class Desk:
    """The operator at the console as the engine sees him. Every method is safe for threads."""

    def __init__(self, *, waits: bool, now_s: Callable[[], float] = time.monotonic) -> None:
        """`waits` where nothing is done and nothing answered before somebody has taken the seat."""
        self._changed = threading.Condition()
        self._now_s = now_s
        self._seat = Seat(now_s)
        self._waits = waits
        self._engine: Engine | None = None
        self._waiting_for: str | None = None  # the upcoming step, while the engine waits between steps
        self._wish: Wish | None = None
        self._standing: _Standing | None = None
        self._nonces: deque[str] = deque(maxlen=NONCES_KEPT)
        self._taken: deque[tuple[str, str, float | None]] = deque()  # as `changes_of_seat`
        self._vacated = 0
        self._gone = False
        self._stopped = False  # and nobody in the seat has answered since

    def attach(self, engine: Engine) -> None:
        """From now on orders are about this engine."""
        with self._changed:
            self._engine = engine
            if name := self._seat.holder:  # taken while the theatre was being opened
                engine.events.publish(SeatEvent(holder=name))

    def leave(self) -> None:
        """The console is gone: whoever else there is goes on."""
        with self._changed:
            self._gone = True
            self._seat.free()
            self._changed.notify_all()

    @property
    def in_charge(self) -> bool:
        """Whether the case is operated from the console: it lives, and somebody has taken its seat."""
        with self._changed:
            return not self._gone and (self._waits or self._seat.ever_taken)

    @property
    def stopped(self) -> bool:
        """Whether somebody at the console stopped the arm, and nobody in its seat has answered since."""
        with self._changed:
            return self._stopped

    @property
    def waits(self) -> bool:
        """Whether nothing is done until someone has taken the seat."""
        return self._waits

    @property
    def gone(self) -> bool:
        """Whether the console has ended."""
        with self._changed:
            return self._gone

    def changes_of_seat(self) -> list[tuple[str, str, float | None]]:
        """Session and name of each person who took the seat since this was last asked; no name: it became
        free. Then the theatre time, None before the theatre was open."""
        with self._changed:
            self._notice_lapse()
            changes = list(self._taken)
            self._taken.clear()
            return changes

    def look(self) -> None:
        """Free the seat of an operator whose page is silent, also while the engine is busy."""
        with self._changed:
            self._notice_lapse()

    # The thread that reads orders

    def take(self, order: AnyOrder) -> str:
        """Take an order; returns why it is refused, or nothing."""
        with self._changed:
            if order.nonce in self._nonces:
                return "this order was already given"
            self._nonces.append(order.nonce)
            self._notice_lapse()
            late = order.expires_s is not None and self._now_s() > order.expires_s
            if late and not isinstance(order, Stop):
                return "the order came too late"
            refused = self._refused(order)
            self._changed.notify_all()
            return refused

    def _refused(self, order: AnyOrder) -> str:
        match order:
            case Claim(session=session, name=name):
                if refused := self._seat.claim(session, name.strip()):
                    return refused
                self._tell_seat(session, name.strip())
                return ""
            case Renew(session=session):
                self._seat.renew(session)
                return ""
            case Stop():
                return self._stop(order.session)
        if not self._seat.held_by(order.session):
            return "you are not in the operator's seat"
        if isinstance(order, Release):
            self._vacate("the operator left the seat")
            return ""
        if self._engine is None:
            return "the theatre is not open yet"
        if isinstance(order, AnswerQuestion):
            return self._answer(order)
        return self._steer(order, self._engine)

    def _steer(self, order: AnyOrder, engine: Engine) -> str:
        name = self._seat.holder
        standing = self._standing
        paused = standing is not None and standing.question.topic is Topic.PAUSE
        vacated = self._vacated
        match order:
            case Pause():
                if self._waiting_for is not None:
                    return "no step is running"
                engine.checkpoint.pause(f"{name} asked for a pause")
            case Abort() if paused:
                self._settle(ABORT, Signature(name, order.session, shown=""))  # it quotes nothing
            case Abort():
                if self._waiting_for is None:
                    engine.checkpoint.abort()
                    if standing is not None:
                        self._settle(standing.question.silence)
                self._wish = Wish("abort", by=name, vacated=vacated)
            case Acknowledge() if paused and standing is not None and standing.answer is None:
                standing.acknowledged_by = name
            case _ if self._waiting_for is None:
                return "the engine is not waiting for an order: a step is running, or a question is open"
            case Next(upcoming=seen) | RunTo(upcoming=seen) | Resume(upcoming=seen) if (
                seen != self._waiting_for
            ):
                return f"out of date: the next step is now {self._waiting_for}"
            case Next():
                self._wish = Wish("next", by=name, vacated=vacated)
            case RunTo(step=step):
                if step not in map(str, engine.order.sequence):
                    return f"there is no step {step!r}"
                if refused := why_not_up_to(engine, engine.order.find(step)):
                    return refused
                self._wish = Wish("to", step, by=name, vacated=vacated)
            case Resume():
                self._wish = Wish("end", by=name, vacated=vacated)
            case Acknowledge():
                self._wish = Wish("acknowledge", by=name, vacated=vacated)
        return ""

    def _stop(self, session: str) -> str:
        engine = self._engine
        if engine is None:
            return "the theatre is not open yet: nothing moves"
        seated = self._seat.held_by(session)
        who = self._seat.holder if seated else f"someone outside the operator's seat (session {session})"
        self._stopped = True
        engine.checkpoint.pause(f"{who} stopped the arm", firm=True)
        threading.Thread(target=engine.setting.workcell.stop, name="stop now").start()
        return ""

    def _answer(self, order: AnswerQuestion) -> str:
        standing = self._standing
        if standing is None or standing.question.number != order.question or standing.answer is not None:
            return "that question is no longer open"
        question = standing.question
        if order.shown != standing.shown:
            return "the question shown is not the question asked"
        if order.answer not in question.answers:
            return f"{order.answer!r} is not an answer"
        read_back = question.read_back
        if read_back is not None and order.answer == question.answers[0]:
            if not order.typed:
                return f"type {read_back.what}"
            if not read_back.fits(order.typed):
                standing.misread += 1
                return f"what was typed {read_back.wrong}"
        if question.reads and order.answer == question.answers[0]:
            if order.readings is None or len(order.readings) != len(question.reads):
                return f"type {', '.join(question.reads)}"
            if wrong := [why for one in order.readings if (why := misread(one, question.plausible_mm))]:
                return "; ".join(wrong)
            standing.readings = order.readings
        if question.topic is Topic.PAUSE:
            self._stopped = False
        self._settle(order.answer, Signature(self._seat.holder, order.session, standing.shown))
        return ""

    def _settle(self, answer: str, signature: Signature | None = None) -> None:
        if self._standing is not None and self._standing.answer is None:
            self._standing.answer, self._standing.signature = answer, signature

    def _notice_lapse(self) -> None:
        if self._seat.lapsed:
            self._vacate("the operator's page has not responded for 10 s")

    def _vacate(self, reason: str) -> None:
        """The seat is free, and what its holder ordered counts no more, save the end of the case."""
        self._seat.free()
        self._vacated += 1
        if self._wish is not None and self._wish.what != "abort":
            self._wish = None
        self._tell_seat("", "", reason)

    def _tell_seat(self, session: str, name: str, reason: str = "") -> None:
        since_s = None
        if self._engine is not None:
            since_s = self._engine.events.publish(SeatEvent(holder=name, reason=reason)).theatre_time_s
        self._taken.append((session, name, since_s))

    # The engine's own thread

    def ask(self, question: Question, acknowledge: Callable[[str], None] = lambda _by: None) -> str | None:
        """The answer from the console; silence in time, and None when the console has ended.

        `acknowledge` is called, at a pause, with the name of who acknowledges faults.
        """
        ends_s = None if question.timeout_s is None else self._now_s() + question.timeout_s
        with self._changed:
            self._standing = standing = _Standing(question, shown_digest(as_shown(question, question.number)))
            try:
                while standing.answer is None and not self._gone:
                    left_s = LOOK_AGAIN_S if ends_s is None else min(LOOK_AGAIN_S, ends_s - self._now_s())
                    if left_s <= 0.0:
                        return question.silence
                    self._changed.wait(left_s)
                    self._notice_lapse()
                    while standing.misread:
                        standing.misread -= 1
                        question.misread()
                    if standing.acknowledged_by:
                        by, standing.acknowledged_by = standing.acknowledged_by, ""
                        self._changed.release()  # devices take seconds, and a stop must get through
                        try:
                            acknowledge(by)
                        finally:
                            self._changed.acquire()
            finally:
                self._standing = None
        if standing.signature is not None:
            question.signed(standing.signature)
        if standing.readings is not None:
            question.read(standing.readings)
        return standing.answer

    def await_seat(self) -> None:
        """Wait, if required, until someone is in the seat or the console has ended."""
        with self._changed:
            while self._waits and not self._seat.holder and not self._gone:
                self._changed.wait(LOOK_AGAIN_S)
                self._notice_lapse()

    def wish(self, upcoming: str, timeout_s: float | None = None) -> Wish | None:
        """Wait between steps for what is wished; None when nothing is in time, or the console has ended."""
        ends_s = None if timeout_s is None else self._now_s() + timeout_s
        with self._changed:
            self._waiting_for = upcoming
            try:
                while self._wish is None and not self._gone:
                    left_s = LOOK_AGAIN_S if ends_s is None else min(LOOK_AGAIN_S, ends_s - self._now_s())
                    if left_s <= 0.0:
                        return None
                    self._changed.wait(left_s)
                    self._notice_lapse()
                wish, self._wish = self._wish, None
                return wish
            finally:
                self._waiting_for = None

    @property
    def aborting(self) -> bool:
        """Whether the end of the case was asked for."""
        with self._changed:
            return self._wish is not None and self._wish.what == "abort"

    def occupied_since(self, vacated: int) -> bool:
        """Whether somebody is in the seat, and it has not become free since it had been so that often."""
        with self._changed:
            self._notice_lapse()
            return bool(self._seat.holder) and self._vacated == vacated
