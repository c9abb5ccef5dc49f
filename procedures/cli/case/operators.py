"""The person at the terminal: answers questions, acts in the room, and types readings."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import TYPE_CHECKING

from typer import style

from procedures.operator.question import NOBODY as NOBODY_READS
from procedures.operator.question import YES, Question, Task, misread, words
from procedures.runs.lifecycle import RunObservers
from ronna_hw.text.printable import printable, printable_lines
from ronna_hw.text.typed_number import typed_number

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

LOOK_AGAIN_S = 0.2  # host time between two looks while nothing is typed
MEANS = "Whatever you answer, no motion and no step begins before the fault is acknowledged by name."


class Alarms:
    """The devices in fault, as they were last seen: asks none of them anything."""

    def __init__(self, means: str = MEANS) -> None:
        """`means` follows what is in fault."""
        self._means = means
        self._engine: Engine | None = None
        self._reported: set[str] = set()  # roles, at this question

    def attach(self, engine: Engine) -> None:
        """From now on the devices of this engine are looked at; before, none."""
        self._engine = engine

    def begin(self) -> None:
        """A question opens: what is in fault already is shown with it."""
        self._reported = set()

    def new(self) -> list[str]:
        """One line for each device in fault of which this question's reader does not know yet."""
        faults = self._faults()
        lines = [f"{what}. {self._means}" for role, what in faults.items() if role not in self._reported]
        self._reported = set(faults)  # one that comes again is shown again
        return lines

    @property
    def note(self) -> str:
        """For the prompt, such as ` (the arm is in fault)`; empty while no device is."""
        roles = " and ".join(f"the {role}" for role in sorted(self._reported))
        return f" ({roles} {'is' if len(self._reported) == 1 else 'are'} in fault)" if roles else ""

    def _faults(self) -> dict[str, str]:
        return {} if self._engine is None else self._engine.faults.in_short


def forget_typed() -> None:
    """What was typed at the terminal and not read yet is lost."""
    with contextlib.suppress(termios.error):  # the terminal is gone, and its end is read
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def awaited(alarms: Alarms, ends_s: float | None = None) -> tuple[bool, list[str]]:
    """Wait at a terminal for a line, the end of time or an alarm: whether there is a line, and what to tell.

    What was typed before an alarm is lost: it was typed without knowing of it.
    """
    while True:
        left_s = LOOK_AGAIN_S if ends_s is None else max(0.0, ends_s - time.monotonic())
        ready, _, _ = select.select([sys.stdin], [], [], min(left_s, LOOK_AGAIN_S))
        if news := alarms.new():
            forget_typed()
            sys.stderr.write("\n")  # the prompt is still there
        if ready or news or (ends_s is not None and time.monotonic() >= ends_s):
            return bool(ready), news


WritePrompt = Callable[[str], None]  # a prompt
Asking = Callable[[], AbstractContextManager[WritePrompt]]  # held while a question stands


def write_prompt(prompt: str) -> None:
    """Write a prompt."""
    sys.stderr.write(prompt)
    sys.stderr.flush()


def undisturbed() -> AbstractContextManager[WritePrompt]:
    """Where nothing else writes."""
    return nullcontext(write_prompt)


AGAIN = "again"
CONTROL = "RONNA_CONTROL"  # in the environment: the control port, for commands that are given none
UNIT = "mm"  # of every reading; it may be typed with the number
SMALL_MM = 0.01  # as a dial shows it

MOST_MISREAD = 3  # wrong values, after which nobody is taken to have read the right one


def terminal_observers(
    asking: Asking = undisturbed, opened: Callable[[Engine], None] = lambda _engine: None
) -> RunObservers:
    """Return observers with the person at the terminal, who is told of devices in fault."""
    alarms = Alarms()

    def attached(engine: Engine) -> None:
        alarms.attach(engine)
        opened(engine)

    return RunObservers(
        opened=attached,
        person=TerminalOperator(asking, alarms),
        staff=lambda simulated: TerminalRoom(asking, simulated=simulated, alarms=alarms),
    )


class TerminalOperator:
    """A person at the terminal. Without a terminal nobody answers.

    `asking` is held while a question is open, so that nothing else overwrites it. `alarms` are told at once,
    and nothing typed before counts.
    """

    def __init__(self, asking: Asking = undisturbed, alarms: Alarms | None = None) -> None:
        self._asking = asking
        self._alarms = Alarms() if alarms is None else alarms

    def ask(self, question: Question) -> str:
        """Write the value and wait for one of the answers, typed whole; anything else is asked again.

        The answer that goes on counts only with what is to be read back, in the same time.
        """
        if not sys.stdin.isatty():
            return question.silence
        ends_s = None if question.timeout_s is None else time.monotonic() + question.timeout_s
        read_back = question.read_back
        with self._asking() as write:
            sys.stderr.write(f"{printable(question.subject)}\n  {_emphasized(question)}\n")
            self._alarms.begin()
            misread_before = 0
            while typed := _typed(write, words(question.answers), ends_s, self._alarms):
                if (answer := typed.lower().strip("'")) not in question.answers:
                    _say(f"{typed!r} is not an answer: type {words(question.answers)} in full.")
                    continue
                if answer != question.answers[0] or read_back is None:
                    return answer
                if not (typed := _typed(write, read_back.what, ends_s, self._alarms)):
                    break
                if read_back.fits(typed):
                    return answer
                question.misread()
                misread_before += 1
                wrong = f"{typed!r} {read_back.wrong.rstrip('.')}."
                if misread_before == MOST_MISREAD:
                    _say(f"{wrong} {MOST_MISREAD} wrong values count as {question.silence!r}.")
                    return question.silence
                _say(f"{wrong} Answer from the start, or {words((question.silence,))} to stop.")
            if ends_s is not None and time.monotonic() >= ends_s:
                sys.stderr.write("\n")  # the prompt is still there
                _say(f"No answer within {question.timeout_s:g} s counts as {question.silence!r}.")
            return question.silence


class TerminalRoom:
    """The hands of the person at the terminal."""

    def __init__(
        self,
        asking: Asking = undisturbed,
        *,
        simulated: bool = False,
        alarms: Alarms | None = None,
    ) -> None:
        """In a `simulated` theatre a tool is mounted by a command."""
        self._asking = asking
        self._alarms = Alarms() if alarms is None else alarms
        self._simulated = simulated

    def announce(self, step: str) -> None:
        """Nothing to do: the person sees the progress."""

    def change_tool(self, number: int, description: str) -> None:
        """Say what to mount; that it is done is confirmed, and recorded, by the step."""
        with self._asking():
            sys.stderr.write(f"Mount {printable(description)} (tool {number}).\n")
            self._hint(f"mount {number}")

    def prepare_stand(self, holds: str) -> None:
        """Say what to put on the calibration stand; that it is done is confirmed by the step."""
        with self._asking():
            _say(f"Put the {holds} on the calibration stand.")
            self._hint(f"stand {holds}")

    def _hint(self, command: str) -> None:
        """In a simulated room things are done by commands."""
        if self._simulated:
            control = "" if os.environ.get(CONTROL) else " --control 'ENDPOINT FROM READY'"
            sys.stderr.write(f"In the simulated room: ronna-sim {command}{control}\n")
        sys.stderr.flush()

    def work(self, task: Task) -> tuple[float, ...]:
        """Say what to do, and have typed what is read off; nothing without a terminal."""
        with self._asking() as write:
            sys.stderr.write(f"{printable(task.subject[:1].upper() + task.subject[1:])}.\n")
            numbers = "".join(f" {number:g}" for number in task.numbers)
            trajectory = f" --trajectory {task.trajectory}" if task.trajectory else ""
            self._hint(f"work {task.name}{numbers}{trajectory}")
            self._alarms.begin()
            return _read_off(write, task, self._alarms) if task.reads and sys.stdin.isatty() else ()


def _read_off(write: WritePrompt, task: Task, alarms: Alarms) -> tuple[float, ...]:
    """What is typed for each reading; several are shown back before they count. Nothing when nobody reads."""
    while True:
        readings: list[float] = []
        for what in task.reads:
            if (number := _typed_number(write, what, task.plausible_mm, alarms, bool(readings))) is None:
                return ()
            readings.append(number)
        if len(readings) == 1:
            return tuple(readings)
        for what, number in zip(task.reads, readings, strict=True):
            _say(f"  {what}: {number:g}")
        while (typed := _typed(write, words((YES, AGAIN)), None, alarms).lower()) != AGAIN:
            if typed == YES or not typed:
                return tuple(readings) if typed else ()
            _say(
                f"{typed!r} is not an answer: {YES} if these are the readings, {AGAIN} to "
                "type them all again."
            )


def _typed_number(
    write: WritePrompt, what: str, plausible: tuple[float, float] | None, alarms: Alarms, ahead: bool
) -> float | None:
    """A number that can be; what is none is asked again. None when nobody reads it or the terminal ends.

    `ahead` takes one of several lines that were pasted; after one that is refused, the others are lost.
    """
    while (typed := _typed(write, what, None, alarms, ahead)) and typed.lower() != NOBODY_READS:
        ahead = False
        with suppress(ValueError):
            number = typed_number(typed, UNIT)
            if not (wrong := misread(number, plausible)):
                return number
            _say(f"{wrong}; type {_one_number(plausible)}")
            continue
        _say(f"{typed!r} is not a reading: type {_one_number(plausible)}")
    return None


def _one_number(plausible: tuple[float, float] | None) -> str:
    """What is to be typed, by an example that is possible."""
    low, high = plausible or (0.0, SMALL_MM)
    example = SMALL_MM if low <= SMALL_MM <= high else round(0.5 * (low + high))
    return f"one number in mm, such as {example:g} or {example:g} mm, or {NOBODY_READS!r} to end the step."


def _say(line: str) -> None:
    sys.stderr.write(f"{printable(line)}\n")


def _emphasized(question: Question) -> str:
    """The value; on a terminal, the part to be read back is in bold."""
    value = printable_lines(question.value).replace("\n", "\n  ")
    shown = question.read_back.shown if question.read_back else ""
    return value.replace(shown, style(shown, bold=True), 1) if shown and sys.stderr.isatty() else value


def _typed(write: WritePrompt, what: str, ends_s: float | None, alarms: Alarms, ahead: bool = False) -> str:
    """What is typed, without the space around it; a blank line is asked again.

    Empty when it is out of time or the terminal is gone. What was typed before it was asked for, or before a
    device was reported in fault, is lost, unless it may be typed `ahead`.
    """
    news = alarms.new()
    if news or not ahead:
        forget_typed()
    while True:
        for said in news:
            _say(said)
        write(f"Type {what}{alarms.note}: ")
        ready, news = awaited(alarms, ends_s)
        if news:
            continue
        line = sys.stdin.readline() if ready else ""
        if not line or line.strip():
            return line.strip()
        _say("Nothing was typed.")
