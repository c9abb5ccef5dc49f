"""Execution of console orders: single steps, up to a step, or to the end of the case."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from procedures.engine.display_feed import HOME, publish_waiting, upcoming_name
from procedures.journal.errors import RunDeleted
from procedures.operator.errors import OperatorAborted
from procedures.operator.question import NOBODY, READ, Answer, Operator, Question, Room, Task, Topic
from procedures.runs.operator_station import OperatorStation, PendingOrder
from procedures.runs.orders import Abort, Acknowledge, Next, Resume, RunTo
from ronna_hw.command_line.messages import fail_with, tell
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

WITHOUT = "the console has ended; continuing runs the case from this terminal"
STOPPED = "the arm was stopped from the console; the case waits for someone in the operator's seat"
HELD = "the case is held, the arm is at rest; the operator at the console decides how to continue"
LOOK_AGAIN_S = 0.1  # host time between two looks at the standard input


def _input_is_ready(timeout_s: float) -> bool:
    return bool(select.select([sys.stdin], [], [], timeout_s)[0])


class ConsoleOperator:
    """Operator that asks at the console while it is in charge, and otherwise asks the fallback.

    A script does not answer after a person stopped the arm: that waits for somebody in the seat.
    """

    def __init__(
        self, station: OperatorStation, fallback: Operator, executor: OrderExecutor, *, script_at_pause: bool
    ) -> None:
        self._station = station
        self._otherwise = fallback
        self._executor = executor
        self._script_at_pause = script_at_pause

    def ask(self, question: Question) -> Answer:
        """Ask at the console, or ask the fallback if the console is not in charge or gone."""
        self._executor.note_seat()
        waits = self._script_at_pause and question.topic is Topic.PAUSE and self._station.stopped
        if waits:
            tell(STOPPED)
        asks_console = waits or self._station.in_charge
        answer = self._station.ask(question, self._executor.acknowledge) if asks_console else None
        self._executor.note_seat()
        if answer is None:  # whoever takes its place reads in another way
            return Answer(question.silence) if waits or question.reads else self._otherwise.ask(question)
        return answer


class OrderExecutor:
    """Executes orders between steps, on the engine's thread."""

    def __init__(
        self, station: OperatorStation, *, runs: bool, input_ready: Callable[[float], bool] = _input_is_ready
    ) -> None:
        """With `runs`, the case continues by itself until the operator orders otherwise.

        `input_ready` says whether something can be read from the standard input within that host time.
        """
        self._input_is_ready = input_ready
        self.station = station
        self.has_led_home = False  # the case was aborted, and led out and home as far as that was confirmed
        self._runs = runs
        self._is_running = runs and not station.in_charge
        self._vacated = 0  # how often the seat had become free when that was ordered
        self._rested = False  # since the console ended
        self._until: str | None = None  # the last step that was ordered; None: all
        self._engine: Engine | None = None

    @property
    def in_charge(self) -> bool:
        """Whether the console operates the case."""
        return self.station.in_charge

    def operator(self, fallback: Operator, *, script_at_pause: bool = False) -> Operator:
        """Return the case's operator; `script_at_pause` if a script is the fallback during pauses."""
        return ConsoleOperator(self.station, fallback, self, script_at_pause=script_at_pause)

    def staff(self, fallback: Room) -> Room:
        """Return room staff whose readings are entered at the console while it is in charge."""
        return ConsoleRoom(fallback, self)

    def read(self, task: Task) -> tuple[float, ...] | None:
        """Ask for the task's readings at the console; return None if the console is not in charge.

        Empty if nobody reads them off.
        """
        if self._engine is None or not self.in_charge:
            return None
        question = Question(
            Topic.READING,
            task.subject,
            f"type {', '.join(task.reads)} as displayed, or {NOBODY} to end the step",
            (READ, NOBODY),
            timeout_s=None,
            reads=task.reads,
            plausible_mm=task.plausible_mm,
        )
        answer = self._engine.questions.ask(question)
        if answer.word != READ:
            return None if self.station.gone else ()
        return answer.readings

    def acknowledge(self, by: str) -> None:
        """Recover the faulted devices and report any failure."""
        if self._engine is None:
            return
        try:
            for role, fault in self._engine.faults.acknowledge(by).items():
                tell(f"acknowledged by {by}: {role}: {fault}")
        except RonnaError as error:
            self._tell_fault(self._engine, error)

    def attach(self, engine: Engine) -> None:
        """Direct all further orders to an engine."""
        self._engine = engine
        engine.is_awaiting_person = lambda: self.station.is_awaiting_person
        self.station.attach(engine)

    def note_seat(self) -> None:
        """Record in the journal each change of the seat since the last call."""
        for session, name, since_s in self.station.changes_of_seat():
            if self._engine is not None:
                self._engine.record_seat(session, name, since_s)

    def await_operator(self) -> None:
        """If the seat must be taken, wait until someone takes it or the console is gone."""
        self.station.await_seat()
        self.note_seat()

    def run_to_end(self, engine: Engine) -> None:
        """Run the case as ordered, then bring the arm home.

        If the console ends, a case that does not continue by itself is left. One that waits for the operator
        rests until it is continued without the console. Raises OperatorAborted, and the errors of steps and
        of the way home while nobody operates.
        """
        while (name := upcoming_name(engine)) is not None:
            self.note_seat()
            in_charge = self.in_charge  # read first: a console that dies now still has this turn, and waits
            gone = self.station.gone
            if gone and not self._runs:
                return
            if gone and self.station.waits and not self._rested:
                self._rested = True
                engine.checkpoint.pause(WITHOUT)  # met before the step begins
            if self._must_wait(in_charge=in_charge):
                self._carry_out(engine, self.station.next_order(self._publish_waiting(engine)))
                continue
            self._run_step(engine, name)

    def follow_until_typed(self, engine: Engine) -> None:
        """Execute console orders until there is input on standard input, or end of file."""
        self._publish_waiting(engine)
        while not self._input_is_ready(0.0):
            self.note_seat()
            in_charge = self.in_charge
            if self.station.gone or engine.machine.ended or (name := upcoming_name(engine)) is None:
                self._input_is_ready(LOOK_AGAIN_S)
            elif self._is_running and not self._must_wait(in_charge=in_charge):
                self._run_step(engine, name)
            else:
                if self._is_running:  # whoever ordered it has left the seat
                    self._is_running = False
                    self._publish_waiting(engine)
                self._carry_out(engine, self.station.next_order(name, LOOK_AGAIN_S))
        self._is_running = False

    def _must_wait(self, *, in_charge: bool) -> bool:
        if not in_charge:
            self._is_running = self._is_running or self._runs  # the console is gone, and the case goes on
            return not self._is_running
        return not self._is_running or not self.station.is_occupied_since(self._vacated)

    def _publish_waiting(self, engine: Engine) -> str:
        publish_waiting(engine)
        return upcoming_name(engine) or ""

    def _run_step(self, engine: Engine, name: str) -> None:
        try:
            if name == HOME:
                engine.retreat_home()
            else:
                engine.run_step(engine.order.find(name))
        except OperatorAborted:
            if self.in_charge:
                self._leave(engine)
            raise
        except RonnaError as error:
            error, agreed = self._continue_by_consent(engine, error)
            if agreed and self._until is None:
                return
            self._is_running, self._until = False, None
            if agreed:  # what was ordered ends here: the steps that come now were not meant
                self._publish_waiting(engine)
                return
            if not self.in_charge or engine.machine.ended or isinstance(error, RunDeleted):
                raise
            if name == HOME:
                self._tell_fault(engine, error)
            else:  # the engine has published it
                fail_with(error)
            if not self.station.aborting:
                tell(HELD)
            self._publish_waiting(engine)
            return
        until = self._until
        if until == name or (until is not None and not engine.course.remains(until)):
            self._is_running, self._until = False, None
        if not self._is_running:
            self._publish_waiting(engine)

    def _continue_by_consent(self, engine: Engine, error: RonnaError) -> tuple[RonnaError, bool]:
        """Return the error to report, and whether the operator agreed to continue."""
        try:
            return error, engine.goes_on(error)
        except OperatorAborted:  # on the way home that was agreed
            if self.in_charge:
                self._leave(engine)
            raise
        except RonnaError as problem:
            return problem, False

    def _carry_out(self, engine: Engine, pending: PendingOrder | None) -> None:
        if pending is None:  # nothing yet, or the console has ended
            return
        match pending.order:
            case Abort():
                self._abort(engine)
                return
            case Acknowledge():
                self.acknowledge(pending.by)
                self._publish_waiting(engine)
                return
            case Next():
                self._until = upcoming_name(engine)
            case RunTo(step=step):
                self._until = step
            case Resume():
                self._until = None  # to the end of the case
        self._is_running, self._vacated = True, pending.times_vacated

    def _abort(self, engine: Engine) -> None:
        """Retreat and park as far as the operator agrees, then end the case. Raises OperatorAborted."""
        try:
            engine.checkpoint.here("before the end of the case")  # an abort that no step has met
        except RonnaError as met:
            if not isinstance(met, OperatorAborted):
                self._tell_fault(engine, met)
        self._leave(engine)
        if not engine.machine.ended:  # on the way home
            engine.abort()
        raise OperatorAborted("the operator ended the procedure")

    def _leave(self, engine: Engine) -> None:
        self.has_led_home = True
        try:
            engine.leave_head()
        except RonnaError as error:
            self._tell_fault(engine, error)

    @staticmethod
    def _tell_fault(engine: Engine, error: RonnaError) -> None:
        from procedures.engine.events import Fault

        fail_with(error)
        engine.events.publish(Fault(code=error.code, what=str(error), advice=error.advice))


class ConsoleRoom:
    """Staff at the terminal whose readings are typed at the console while it is in charge."""

    def __init__(self, fallback: Room, executor: OrderExecutor) -> None:
        self._otherwise = fallback
        self._executor = executor

    def announce(self, step: str) -> None:
        """Tell the staff which step is running."""
        self._otherwise.announce(step)

    def change_tool(self, number: int, description: str) -> None:
        """Ask the staff to change the tool; the step has it confirmed at the console."""
        self._otherwise.change_tool(number, description)

    def prepare_stand(self, holds: str) -> None:
        """Ask the staff to prepare the stand; the step has it confirmed at the console."""
        self._otherwise.prepare_stand(holds)

    def work(self, task: Task) -> tuple[float, ...]:
        """Prompt for the task; its readings are typed at the console."""
        if task.reads and self._executor.in_charge:
            self._otherwise.work(replace(task, reads=()))
            if (readings := self._executor.read(task)) is not None:
                return readings
        return self._otherwise.work(task)
