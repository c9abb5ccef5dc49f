"""The operator at the terminal: answering questions, in words that count only in full."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import sys
import termios
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from typer import style

from procedures.operator.question import (
    HELP,
    MISREAD_REASON,
    MOST_MISREAD,
    Answer,
    Question,
    ReadBack,
    join_answers,
    pick_answer,
    tries_left,
)
from procedures.runs.orders import COMMANDS
from ronna_hw.command_line.messages import takes_escapes
from ronna_hw.evidence.manifest import PICTURES_FOLDER
from ronna_hw.text import printable, printable_lines

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

LOOK_AGAIN_S = 0.2  # host time between two looks while nothing is typed
LONGEST_PART = 4096  # bytes; a terminal hands over no longer line
ADVICE = "Whatever you answer, no motion and no step begins before the fault is acknowledged by name."


class WritePrompt(Protocol):
    """Writer of prompts."""

    def __call__(self, prompt: str, /, *, question: str = "") -> None:
        """Write a prompt. The question it belongs to stands above it already."""
        ...


Asking = Callable[[], AbstractContextManager[WritePrompt]]  # held while a question is open
LEAVING = "Ctrl-C twice ends the command"  # while a question is open
NOT_HERE = frozenset((*COMMANDS, "exit", "q"))  # typed at a prompt, not at a question
RULE = f"Answers count in full, in upper or lower case; {HELP} explains those of a question."


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

    @property
    def instrument(self) -> str | None:
        """Statement that an instrument is or may be inside; None if not."""
        return None if self._engine is None else self._engine.setting.workcell.instrument_description

    @property
    def run_folder(self) -> Path:
        """Folder of the run, with its whole path."""
        return Path("RUN") if self._engine is None else self._engine.case.folder.resolve()

    def _faults(self) -> dict[str, str]:
        return {} if self._engine is None else self._engine.faults.summaries


def forget_typed() -> None:
    """Discard unread terminal input, and say so if there was any."""
    with contextlib.suppress(termios.error, OSError):  # the terminal is gone, and its end is read
        unread = fcntl.ioctl(sys.stdin, termios.FIONREAD, bytes(4))
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
        if any(unread):
            say_line("What was typed ahead was not used.")


def await_line(alarms: Alarms, deadline_s: float | None = None) -> tuple[str | None, list[str]]:
    """Wait for a whole line, an alarm or the deadline; return the line, or None, and any new alarm lines.

    The line is empty at the end of the input; one that was not finished counts for nothing. Input typed
    before an alarm, also the start of a line, is discarded: it was typed without knowing of it.
    """
    typed = b""
    while True:
        remaining_s = LOOK_AGAIN_S if deadline_s is None else max(0.0, deadline_s - time.monotonic())
        ready, _, _ = select.select([sys.stdin], [], [], min(remaining_s, LOOK_AGAIN_S))
        part = _read_part() if ready else None
        if news := alarms.take_new_lines():
            forget_typed()
            sys.stderr.write("\n")  # the prompt is still there
            return None, news
        if part is not None:
            typed = typed + part if part else b""
            if not part or typed.endswith(b"\n"):
                return typed.decode(errors="replace"), []
        if deadline_s is not None and time.monotonic() >= deadline_s:
            return None, []


def _read_part() -> bytes:
    """Read what the terminal hands over: a line, or part of one after Ctrl-D; empty if it has ended."""
    try:
        return os.read(sys.stdin.fileno(), LONGEST_PART)
    except OSError:  # the terminal is gone
        return b""


def write_prompt(prompt: str, *, question: str = "") -> None:
    """Write a prompt, as `WritePrompt` does."""
    sys.stderr.write(prompt)
    sys.stderr.flush()


def plain_prompt() -> AbstractContextManager[WritePrompt]:
    """Return the prompt writer for a terminal that nothing else writes to."""
    return nullcontext(write_prompt)


@dataclass
class TerminalOperator:
    """Operator who answers at the terminal; without a terminal, questions go unanswered.

    `asking` is held while a question is open, so that nothing else overwrites it. `alarms` are told at once,
    and nothing typed before counts.
    """

    asking: Asking = plain_prompt
    alarms: Alarms = field(default_factory=Alarms)
    _knows_rule: bool = field(default=False, init=False)

    def ask(self, question: Question) -> Answer:
        """Show a question and wait until one of its answers is typed in full, repeating after other input.

        The first answer counts only with the value to be read back, within the same time limit.
        """
        silence = Answer(question.silence)
        if not sys.stdin.isatty():
            return silence
        deadline_s = None if question.timeout_s is None else time.monotonic() + question.timeout_s
        read_back = question.read_back
        with self.asking() as write_below:
            if not self._knows_rule:
                say_line(RULE)
                self._knows_rule = True
            described = _describe_question(question, self.alarms)
            sys.stderr.write(described)
            write = partial(write_below, question=described)
            self.alarms.begin()
            while typed := read_typed(write, join_answers(question.answers), deadline_s, self.alarms):
                if (word := pick_answer(typed, question.answers)) is None:
                    if pick_answer(typed, (HELP,)) is not None:
                        self._explain(question)
                        continue
                    say_line(
                        f"{typed!r} is not an answer: type {join_answers(question.answers)} in full."
                        f"{self._how_to_leave(typed)}"
                    )
                    continue
                if word != question.answers[0] or read_back is None:
                    return Answer(word)
                if (answer := self._read_back(write, question, read_back, deadline_s)) is not None:
                    return answer
                break
            if deadline_s is not None and time.monotonic() >= deadline_s:
                sys.stderr.write("\n")  # the prompt is still there
                say_line(f"No answer within {question.timeout_s:g} s counts as {silence.word!r}.")
            return silence

    def _read_back(
        self, write: WritePrompt, question: Question, read_back: ReadBack, deadline_s: float | None
    ) -> Answer | None:
        """Ask for the value after the first answer, until it or another answer is typed, or no try is left.

        None if time is out or the terminal is gone.
        """
        others = question.answers[1:]
        misread = 0
        while typed := read_typed(write, read_back.what, deadline_s, self.alarms):
            if read_back.fits(typed):
                return Answer(question.answers[0], typed)
            if (word := pick_answer(typed, others)) is not None:
                return Answer(word)
            if pick_answer(typed, (HELP,)) is not None:
                say_line(f"Type {read_back.what}, or {join_answers(others)} to stop.")
                self._explain_ending(question)
                continue
            if leave := self._how_to_leave(typed):
                say_line(
                    f"{typed!r} is no value: type {read_back.what}, or {join_answers(others)} to stop.{leave}"
                )
                continue
            question.misread()
            misread += 1
            wrong = f"{typed!r} {read_back.wrong.rstrip('.')}."
            if misread == MOST_MISREAD:
                say_line(f"{wrong} {MOST_MISREAD} wrong values count as {question.silence!r}.")
                return Answer(question.silence, silence_reason=MISREAD_REASON)
            say_line(f"{wrong} Type it again, or {join_answers(others)} to stop; {tries_left(misread)}.")
        return None

    def _how_to_leave(self, typed: str) -> str:
        """Return what to do for a command typed at a question; empty for other words."""
        command = " ".join(typed.split()[:1]).casefold()
        if command not in NOT_HERE:
            return ""
        return f" Commands such as {command} count after the question; {self._leaving}."

    def _explain(self, question: Question) -> None:
        """Write what can be typed at a question, how to leave it, and what counts without an answer."""
        say_line(f"Type {join_answers(question.answers)}.")
        if question.read_back is not None:
            say_line(f"After {question.answers[0]!r}, type {question.read_back.what}.")
        self._explain_ending(question)

    def _explain_ending(self, question: Question) -> None:
        """Write how to leave a question, and what counts without an answer."""
        say_line(f"Commands count after the question; {self._leaving}.")
        if question.timeout_s is None:
            say_line(f"It waits until it is answered; the end of the input counts as {question.silence!r}.")
        else:
            say_line(f"No answer within {question.timeout_s:g} s counts as {question.silence!r}.")

    @property
    def _leaving(self) -> str:
        """How to end the command, which is not advised while an instrument is inside."""
        inside = self.alarms.instrument
        return LEAVING if inside is None else f"answer it first: {inside}"


def say_line(line: str) -> None:
    """Write a line beside the prompts."""
    sys.stderr.write(f"{printable(line)}\n")


def _describe_question(question: Question, alarms: Alarms) -> str:
    """Describe a question; what decides it and what is to be read back is bold on a terminal that can."""
    identity = () if question.identity is None else question.identity.rows
    statements = printable_lines(question.value).splitlines()
    bullet = "- " if len(statements) > 1 else ""
    lines = [
        printable(question.subject),
        *(f"  {printable(f'{name}: {said}')}" for name, said in identity),
        *(f"  {bullet}{statement}" for statement in statements),
        *(f"  {predicted.sentence}" for predicted in question.predicted[:1]),
        *(
            f"  picture: {printable(str(alarms.run_folder / PICTURES_FOLDER / one.name))}"
            for one in question.pictures
        ),
    ]
    text = "\n".join(lines) + "\n"
    bold = [question.read_back.shown] if question.read_back else []
    for predicted in question.predicted[:1]:
        bold += [f"{predicted.rms_mm:.2f} mm rms", f"margin of {predicted.margin_mm:g} mm"]
    if takes_escapes(sys.stderr):
        for shown in filter(None, bold):
            text = text.replace(shown, style(shown, bold=True), 1)
    return text


def read_typed(
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
            say_line(fault_line)
        write(f"Type {what}{alarms.note}: ")
        line, news = await_line(alarms, deadline_s)
        if news:
            continue
        if not line or line.strip():
            return (line or "").strip()
        say_line("Nothing was typed.")
