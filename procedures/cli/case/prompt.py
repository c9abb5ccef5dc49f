"""Prompt that carries out the operator's commands until the input or the case ends."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from procedures.cli.case.commands import Say, carry_out, continue_hint, read_command, why_not_skipped
from procedures.cli.case.operators import Alarms, Asking, WritePrompt, await_line, forget_typed, plain_prompt
from procedures.cli.case.staff import WORDS
from procedures.engine.errors import UnknownStep
from procedures.engine.states import ABORTED
from procedures.engine.states import HELD as MACHINE_HELD
from procedures.journal.errors import RunDeleted, StepRefused
from procedures.operator.checkpoint import CONTINUE
from procedures.operator.errors import OperatorAborted
from procedures.operator.question import Answer, Question
from procedures.runs.lifecycle import leave_head_if_agreed
from procedures.runs.orders import COMMANDS, PAUSE_ANSWERS, PAUSED, Abort, Acknowledge, Next, Quit, Resume
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.terminal import fail_with, on_terminal
from ronna_hw.errors import RonnaError
from ronna_hw.near_names import find_near

if TYPE_CHECKING:
    from procedures.cli.case.piped_lines import PipedLines
    from procedures.engine.engine import Engine

HELD = (
    "the case is held, the arm is at rest: next, run STEP, why, back STEP, home, acknowledge YOUR-NAME, "
    "abort, quit"
)
TO_CONTINUE = "No motion and no step begins before it is acknowledged by name; why shows what to do."
AT_PAUSE = {rule.command: rule for rule in COMMANDS.values() if PAUSED in rule.at_prompt}
ENDING_PAUSE = {CONTINUE: CONTINUE} | {
    name: PAUSE_ANSWERS[rule.order] for name, rule in AT_PAUSE.items() if rule.order in PAUSE_ANSWERS
}
AT_PAUSE_CHOICES = " | ".join(
    (
        *ENDING_PAUSE,
        *(f"{name} {rule.argument}".strip() for name, rule in AT_PAUSE.items() if name not in ENDING_PAUSE),
    )
)
TO_LEAVE_PAUSE = "resume goes on with it, abort retreats, drives home and ends it"
SYNONYMS = {"exit": "quit", "continue": "resume"}  # without these the nearest match might move the arm
NOTHING_DONE = (StepRefused, UnknownStep, UsageMistake)


class Prompt:
    """Command prompt. `asking` is entered while it waits for input."""

    def __init__(
        self,
        words: str,
        say: Say,
        *,
        asking: Asking = plain_prompt,
        after: Callable[[], object] = lambda: None,
        resumes: bool = False,
        meanwhile: Callable[[Engine], None] | None = None,
        piped: PipedLines | None = None,
    ) -> None:
        """Set the prompt text `words`, shown on a terminal, and `after`, called after each command.

        `meanwhile` returns when something can be read; until then the case may be operated from elsewhere.
        `piped` supplies the lines when the input is not a terminal.
        With `resumes`, `resume` leaves the prompt and the case continues.
        """
        self._resumes = resumes
        self._words = words
        self._say = say
        self._asking = asking
        self._after = after
        self._meanwhile = meanwhile
        self._piped = piped
        self._engine: Engine | None = None
        self._alarms = Alarms(TO_CONTINUE)
        self.input_ended = False

    def attach(self, engine: Engine) -> None:
        """Set the engine that this prompt operates."""
        if engine is not self._engine:
            self._alarms.attach(engine)
        self._engine = engine

    def follow(self, engine: Engine) -> bool:
        """Carry out commands until `quit` or the end of input; return whether the case goes on.

        Failures are shown and leave the case held. With `resumes`, a finished case goes on without further
        commands. Raises the error that ended the case.
        """
        self.attach(engine)
        while (line := self._read_command(engine)) is not None:
            name, argument = _command_of(line)
            if name not in COMMANDS:
                self._say(self._unknown(name, argument, COMMANDS, "help lists the commands"))
                continue
            order = COMMANDS[name].order
            if _has_surplus_argument(name, argument):
                self._say(f"{name} takes no argument; nothing was done")
            elif order is Quit:
                if (left := engine.setting.workcell.instrument_description) is None:
                    if not engine.machine.ended:
                        run = shlex.quote(str(engine.case.folder))
                        self._say(f"the case is left as it is; to continue: ronna-procedure resume {run}")
                    return False
                self._say(f"{left}: home asks whether it is out, then drives home")
            elif self._resumes and (order is Resume or (order is Next and engine.upcoming is None)):
                return True  # with nothing upcoming, the way home is next
            else:
                self._carry_out(engine, name, argument)
                if self._resumes and engine.machine.ended:
                    return True
        return False

    def ask(self, question: Question) -> Answer:
        """At a pause, ask for `resume`, `abort` or a command without motion. End of input ends the case."""
        if on_terminal(sys.stdin):  # what was typed before the pause was seen answers nothing
            forget_typed()
        self._say(f"{question.subject}; {question.value}")
        self._say(AT_PAUSE_CHOICES)
        while (line := self._read_line("paused> ")) is not None:
            name, argument = _command_of(line)
            if _has_surplus_argument(name, argument):
                self._say(f"{name} takes no argument; nothing was done")
            elif name in ENDING_PAUSE:
                return Answer(ENDING_PAUSE[name])
            elif (engine := self._engine) is not None and name in AT_PAUSE:
                try:
                    carry_out(engine, read_command(engine, name, argument), self._say, by=argument)
                except RonnaError as mistake:
                    fail_with(mistake)
            elif name in COMMANDS:
                self._say(
                    f"{name} is not available while the case is paused: {TO_LEAVE_PAUSE}; {AT_PAUSE_CHOICES}"
                )
            else:
                self._say(self._unknown(name, argument, (*ENDING_PAUSE, *AT_PAUSE), AT_PAUSE_CHOICES))
        return Answer(question.silence)

    def _unknown(self, name: str, argument: str, known: Iterable[str], choices: str) -> str:
        """Return the reply to an unknown command."""
        if name == "skip" and self._engine is not None:  # often expected, but every result is needed later
            try:
                return f"there is no command 'skip': {why_not_skipped(self._engine, argument)}"
            except RonnaError as mistake:
                return f"there is no command 'skip': {mistake}"
        if name in WORDS:
            return f"{name!r} is manual work, which is typed when the case asks for it; {choices}"
        words = list(known)
        suggestions = [SYNONYMS[name]] if SYNONYMS.get(name) in words else find_near(name, words)
        message = f"there is no command {name!r}" if name else "nothing was typed"
        return f"{message}; did you mean {suggestions[0]}?" if suggestions else f"{message}; {choices}"

    def _carry_out(self, engine: Engine, name: str, argument: str) -> None:
        order = COMMANDS[name].order
        try:
            carry_out(engine, read_command(engine, name, argument), self._say, by=argument)
        except OperatorAborted:
            if order is not Abort:  # which has left the head before
                leave_head_if_agreed(engine)
            raise
        except RonnaError as error:
            if engine.machine.state == ABORTED or isinstance(error, RunDeleted):
                raise
            if engine.machine.state == MACHINE_HELD and not isinstance(error, NOTHING_DONE):
                self.tell_held(engine, error)
            else:
                fail_with(error)
        else:
            if order is Acknowledge and not engine.faults.now:
                self._say(f"the arm is at rest; {self._continue_hint(engine)}")
        self._after()

    def tell_held(self, engine: Engine, error: RonnaError) -> None:
        """Show why the case is held, the state of any faulted device, and how to continue."""
        faults = engine.faults.descriptions
        fail_with(error, advice="" if faults else None)
        for fault in faults.values():
            if fault not in str(error):
                self._say(fault)
        self._alarms.take_new_lines()  # shown here already
        self._say(f"{HELD}; {self._continue_hint(engine)}")

    def _continue_hint(self, engine: Engine) -> str:
        """Return the hint on how to continue the case at this prompt."""
        if self._resumes:
            return "resume continues, next does one step"
        return continue_hint(engine, f"next runs {engine.upcoming}")

    def _read_command(self, engine: Engine) -> str | None:
        if self._meanwhile is None:
            return self._read_line(self._words)
        if on_terminal(sys.stdin):
            sys.stderr.write(self._words)
            sys.stderr.flush()
        self._meanwhile(engine)
        return self._read_line("")

    def _read_line(self, words: str) -> str | None:
        with self._asking() as write:
            if on_terminal(sys.stdin):
                line = self._await_line(words, write)
            else:
                line = (self._piped or sys.stdin).readline()
            self.input_ended = not line
            return line or None

    def _await_line(self, words: str, write: WritePrompt) -> str:
        """Show the prompt until a line is typed, repeating it after each new fault."""
        news = self._alarms.take_new_lines()
        if news:
            forget_typed()
            words = words or self._words  # it was shown before
        while True:
            for message in news:
                self._say(message)
            write(words)
            line, news = await_line(self._alarms)
            if line is not None:
                return line


def _command_of(line: str) -> tuple[str, str]:
    """Split a line into command, in lower case, and argument."""
    name, _, argument = line.strip().partition(" ")
    name = name.lower()
    return "quit" if name == "q" else name, argument.strip()


def _has_surplus_argument(name: str, argument: str) -> bool:
    """Return whether a command that takes no argument was given one."""
    return bool(argument) and (name in ENDING_PAUSE or (name in COMMANDS and not COMMANDS[name].argument))
