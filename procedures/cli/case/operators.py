"""The operator at the terminal: answering questions, acting in the room and typing readings."""

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

from procedures.operator.question import (
    MOST_MISREAD,
    YES,
    Answer,
    Question,
    Task,
    join_answers,
    misread,
    tries_left,
)
from procedures.operator.question import NOBODY as NOBODY_READS
from procedures.runs.observers import RunObservers
from ronna_hw.evidence.manifest import PICTURES_FOLDER
from ronna_hw.text import parse_typed_number, printable, printable_lines

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

LOOK_AGAIN_S = 0.2  # host time between two looks while nothing is typed
ADVICE = "Whatever you answer, no motion and no step begins before the fault is acknowledged by name."
WritePrompt = Callable[[str], None]  # a prompt
Asking = Callable[[], AbstractContextManager[WritePrompt]]  # held while a question is open
AGAIN = "again"
CONTROL = "RONNA_CONTROL"  # in the environment: the control port, for commands that are given none
UNIT = "mm"  # of every reading; it may be typed with the number
SMALL_MM = 0.01  # as a dial shows it


class Alarms:
    """Last known device faults, shown with a question or prompt. No device is queried.

    A person may answer in the belief that the arm can move.
    """

    def __init__(self, advice: str = ADVICE) -> None:
        """Set the `advice` appended to each fault description."""
        self._advice = advice
        self._engine: Engine | None = None
        self._reported: set[str] = set()  # roles, at this question

    def attach(self, engine: Engine) -> None:
        """Watch the devices of this engine."""
        self._engine = engine

    def begin(self) -> None:
        """Start a new question, so that current faults are shown again."""
        self._reported = set()

    def take_new_lines(self) -> list[str]:
        """Return one line for each faulted device not yet shown with this question."""
        faults = self._faults()
        lines = [f"{what}. {self._advice}" for role, what in faults.items() if role not in self._reported]
        self._reported = set(faults)  # a recurring fault is shown again
        return lines

    @property
    def note(self) -> str:
        """Suffix for the prompt, such as ` (the arm is in fault)`; empty without a fault."""
        roles = " and ".join(f"the {role}" for role in sorted(self._reported))
        return f" ({roles} {'is' if len(self._reported) == 1 else 'are'} in fault)" if roles else ""

    def _faults(self) -> dict[str, str]:
        return {} if self._engine is None else self._engine.faults.summaries


def forget_typed() -> None:
    """Discard unread terminal input."""
    with contextlib.suppress(termios.error):  # the terminal is gone, and its end is read
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def await_input(alarms: Alarms, deadline_s: float | None = None) -> tuple[bool, list[str]]:
    """Wait for input, an alarm or the deadline; return whether a line is ready, and any new alarm lines.

    Input typed before an alarm is discarded: it was typed without knowing of it.
    """
    while True:
        remaining_s = LOOK_AGAIN_S if deadline_s is None else max(0.0, deadline_s - time.monotonic())
        ready, _, _ = select.select([sys.stdin], [], [], min(remaining_s, LOOK_AGAIN_S))
        if news := alarms.take_new_lines():
            forget_typed()
            sys.stderr.write("\n")  # the prompt is still there
        if ready or news or (deadline_s is not None and time.monotonic() >= deadline_s):
            return bool(ready), news


def write_prompt(prompt: str) -> None:
    """Write a prompt."""
    sys.stderr.write(prompt)
    sys.stderr.flush()


def plain_prompt() -> AbstractContextManager[WritePrompt]:
    """Return the prompt writer for a terminal that nothing else writes to."""
    return nullcontext(write_prompt)


def terminal_observers(
    asking: Asking = plain_prompt, opened: Callable[[Engine], None] = lambda _engine: None
) -> RunObservers:
    """Return observers for an operator at the terminal, with device alarms shown at each question."""
    alarms = Alarms()

    def attach_alarms(engine: Engine) -> None:
        alarms.attach(engine)
        opened(engine)

    return RunObservers(
        opened=attach_alarms,
        person=TerminalOperator(asking, alarms),
        staff=lambda simulated: TerminalRoom(asking, simulated=simulated, alarms=alarms),
    )


class TerminalOperator:
    """Operator who answers at the terminal; without a terminal, questions go unanswered.

    `asking` is held while a question is open, so that nothing else overwrites it. `alarms` are told at once,
    and nothing typed before counts.
    """

    def __init__(self, asking: Asking = plain_prompt, alarms: Alarms | None = None) -> None:
        self._asking = asking
        self._alarms = Alarms() if alarms is None else alarms

    def ask(self, question: Question) -> Answer:
        """Show a question and wait until one of its answers is typed in full, repeating after other input.

        The first answer counts only with the value to be read back, within the same time limit.
        """
        silence = Answer(question.silence)
        if not sys.stdin.isatty():
            return silence
        deadline_s = None if question.timeout_s is None else time.monotonic() + question.timeout_s
        read_back = question.read_back
        with self._asking() as write:
            sys.stderr.write(_describe_question(question))
            self._alarms.begin()
            misread_before = 0
            while typed := _read_typed(write, join_answers(question.answers), deadline_s, self._alarms):
                if (word := typed.lower().strip("'")) not in question.answers:
                    _say(f"{typed!r} is not an answer: type {join_answers(question.answers)} in full.")
                    continue
                if word != question.answers[0] or read_back is None:
                    return Answer(word)
                if not (typed := _read_typed(write, read_back.what, deadline_s, self._alarms)):
                    break
                if read_back.fits(typed):
                    return Answer(word, typed)
                question.misread()
                misread_before += 1
                wrong = f"{typed!r} {read_back.wrong.rstrip('.')}."
                if misread_before == MOST_MISREAD:
                    _say(f"{wrong} {MOST_MISREAD} wrong values count as {silence.word!r}.")
                    return silence
                _say(
                    f"{wrong} Answer from the start, or {join_answers((silence.word,))} to stop; "
                    f"{tries_left(misread_before)}."
                )
            if deadline_s is not None and time.monotonic() >= deadline_s:
                sys.stderr.write("\n")  # the prompt is still there
                _say(f"No answer within {question.timeout_s:g} s counts as {silence.word!r}.")
            return silence


class TerminalRoom:
    """Room staff, represented by the person at the terminal."""

    def __init__(
        self,
        asking: Asking = plain_prompt,
        *,
        simulated: bool = False,
        alarms: Alarms | None = None,
    ) -> None:
        """Set up the prompts; in a `simulated` theatre they show the command that does the work."""
        self._asking = asking
        self._alarms = Alarms() if alarms is None else alarms
        self._simulated = simulated

    def announce(self, step: str) -> None:
        """Do nothing: progress is already visible."""

    def change_tool(self, number: int, description: str) -> None:
        """Ask for a tool to be mounted; the step confirms and records it."""
        with self._asking():
            sys.stderr.write(f"Mount {printable(description)} (tool {number}).\n")
            self._hint(f"mount {number}")

    def prepare_stand(self, holds: str) -> None:
        """Ask for an object to be put on the calibration stand; the step confirms it."""
        with self._asking():
            _say(f"Put the {holds} on the calibration stand.")
            self._hint(f"stand {holds}")

    def _hint(self, command: str) -> None:
        """Show the command that does the work in a simulated room."""
        if self._simulated:
            control = "" if os.environ.get(CONTROL) else " --control 'ENDPOINT FROM READY'"
            sys.stderr.write(f"In the simulated room: ronna-sim {command}{control}\n")
        sys.stderr.flush()

    def work(self, task: Task) -> tuple[float, ...]:
        """Ask for a task to be done and return the typed readings; empty without a terminal."""
        with self._asking() as write:
            sys.stderr.write(f"{printable(task.subject[:1].upper() + task.subject[1:])}.\n")
            numbers = "".join(f" {number:g}" for number in task.numbers)
            trajectory = f" --trajectory {task.trajectory}" if task.trajectory else ""
            self._hint(f"work {task.name}{numbers}{trajectory}")
            self._alarms.begin()
            return _read_values(write, task, self._alarms) if task.reads and sys.stdin.isatty() else ()


def _read_values(write: WritePrompt, task: Task, alarms: Alarms) -> tuple[float, ...]:
    """Read and return the task's values, confirmed if there are several; empty if none are entered."""
    while True:
        readings: list[float] = []
        for what in task.reads:
            if (
                number := _read_plausible_number(write, what, task.plausible_mm, alarms, bool(readings))
            ) is None:
                return ()
            readings.append(number)
        if len(readings) == 1:
            return tuple(readings)
        for what, number in zip(task.reads, readings, strict=True):
            _say(f"  {what}: {number:g}")
        while (typed := _read_typed(write, join_answers((YES, AGAIN)), None, alarms).lower()) != AGAIN:
            if typed == YES or not typed:
                return tuple(readings) if typed else ()
            _say(
                f"{typed!r} is not an answer: {YES} if these are the readings, {AGAIN} to "
                "type them all again."
            )


def _read_plausible_number(
    write: WritePrompt, what: str, plausible: tuple[float, float] | None, alarms: Alarms, ahead: bool
) -> float | None:
    """Prompt until a plausible number is typed; return None if no reading is available or input ends.

    `ahead` accepts one of several pasted lines; after one that is refused, the others are discarded.
    """
    while (typed := _read_typed(write, what, None, alarms, ahead)) and typed.lower() != NOBODY_READS:
        ahead = False
        with suppress(ValueError):
            number = parse_typed_number(typed, UNIT)
            if not (wrong := misread(number, plausible)):
                return number
            _say(f"{wrong}; type {_number_hint(plausible)}")
            continue
        _say(f"{typed!r} is not a reading: type {_number_hint(plausible)}")
    return None


def _number_hint(plausible: tuple[float, float] | None) -> str:
    """Return the expected format of a reading, with a plausible example."""
    low, high = plausible or (0.0, SMALL_MM)
    example = SMALL_MM if low <= SMALL_MM <= high else round(0.5 * (low + high))
    return f"one number in mm, such as {example:g} or {example:g} mm, or {NOBODY_READS!r} to end the step."


def _say(line: str) -> None:
    sys.stderr.write(f"{printable(line)}\n")


def _describe_question(question: Question) -> str:
    """Describe a question; what decides it and what is to be read back is bold on a terminal."""
    identity = () if question.identity is None else question.identity.rows
    statements = printable_lines(question.value).splitlines()
    bullet = "- " if len(statements) > 1 else ""
    lines = [
        printable(question.subject),
        *(f"  {printable(f'{name}: {said}')}" for name, said in identity),
        *(f"  {bullet}{statement}" for statement in statements),
        *(f"  {predicted.verdict}" for predicted in question.predicted[:1]),
        *(
            f"  picture: {PICTURES_FOLDER}/{picture.name} in the run's folder"
            for picture in question.pictures
        ),
    ]
    text = "\n".join(lines) + "\n"
    bold = [question.read_back.shown] if question.read_back else []
    for predicted in question.predicted[:1]:
        bold += [f"{predicted.rms_mm:.2f} mm rms", f"margin of {predicted.margin_mm:g} mm"]
    if sys.stderr.isatty():
        for shown in filter(None, bold):
            text = text.replace(shown, style(shown, bold=True), 1)
    return text


def _read_typed(
    write: WritePrompt, what: str, deadline_s: float | None, alarms: Alarms, ahead: bool = False
) -> str:
    """Read a typed line without surrounding space; ask again after a blank line.

    Empty if time is out or the terminal is gone. Input typed before the question, or before a device was
    reported in fault, is discarded, unless it may be typed `ahead`.
    """
    news = alarms.take_new_lines()
    if news or not ahead:
        forget_typed()
    while True:
        for fault_line in news:
            _say(fault_line)
        write(f"Type {what}{alarms.note}: ")
        ready, news = await_input(alarms, deadline_s)
        if news:
            continue
        line = sys.stdin.readline() if ready else ""
        if not line or line.strip():
            return line.strip()
        _say("Nothing was typed.")
