"""The theatre staff at the terminal: told what to do or, in a rehearsal, acting on a typed word.

A word has one task done in the simulated room, and only while the case waits for that task.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from procedures.cli.case.operators import (
    Alarms,
    Asking,
    TerminalOperator,
    WritePrompt,
    plain_prompt,
    read_typed,
    say_line,
)
from procedures.cli.case.readings import join_reads, read_values
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import HELP, NOBODY, Room, Task, join_answers, pick_answer
from procedures.runs.observers import RunObservers
from ronna_hw.control_port import VARIABLE, ControlRequestRefused
from ronna_hw.text import parse_typed_number, printable
from ronna_hw.wire.room_tasks import DEPTH_STOP, OUT, TASKS, OnStand

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

MOUNT, STAND = "mount", "stand"
WORDS = frozenset(TASKS) | {MOUNT, STAND}  # of manual work
STAND_HOLDS = tuple(OnStand)
SETTABLE = (DEPTH_STOP,)  # tasks whose number a person may set otherwise than was asked
UNIT = "mm"
NO_CONTROL = (
    f'ronna-sim needs {VARIABLE}, which eval "$(ronna-sim env THEATRE-FOLDER)" sets in that terminal. Set '
    "here, --ask has this work done by a word in this one."
)

Readings = tuple[float, ...]


@dataclass
class TerminalRoom:
    """Room staff, represented by the person at the terminal.

    In a `simulated` theatre the prompts show the command that does the work.
    """

    asking: Asking = plain_prompt
    simulated: bool = field(default=False, kw_only=True)
    alarms: Alarms = field(default_factory=Alarms, kw_only=True)
    _explains: bool = field(  # once, where the command finds the room
        default_factory=lambda: not os.environ.get(VARIABLE), init=False
    )

    def announce(self, step: str) -> None:
        """Do nothing: progress is already visible."""

    def change_tool(self, number: int, description: str) -> None:
        """Ask for a tool to be mounted; the step confirms and records it."""
        with self.asking():
            say_line(f"Mount {description} (tool {number}).")
            self._hint(f"{MOUNT} {number}")

    def prepare_stand(self, holds: str) -> None:
        """Ask for an object to be put on the calibration stand; the step confirms it."""
        with self.asking():
            say_line(f"Put the {holds} on the calibration stand.")
            self._hint(f"{STAND} {holds}")

    def work(self, task: Task) -> Readings:
        """Ask for a task to be done and return the typed readings; empty without a terminal."""
        with self.asking() as write:
            say_line(_as_order(task))
            numbers = "".join(f" {number:g}" for number in task.numbers)
            trajectory = f" --trajectory {task.trajectory}" if task.trajectory else ""
            self._hint(f"work {task.name}{numbers}{trajectory}")
            self.alarms.begin()
            return read_values(write, task, self.alarms) if task.reads and sys.stdin.isatty() else ()

    def _hint(self, command: str) -> None:
        """Show the command that does the work in a simulated room."""
        if self.simulated:
            say_line(f"In the simulated room: ronna-sim {command}")
            if self._explains:
                say_line(NO_CONTROL)
                self._explains = False
        sys.stderr.flush()


@dataclass(frozen=True)
class _Due:
    """Work that the case waits for: its word, and how the staff do what was typed.

    `do` takes what follows the first word and returns what was done and read off. It raises ValueError, with
    what is expected, for anything that cannot follow.
    """

    word: str  # as it is asked for
    meaning: str
    do: Callable[[Sequence[str]], tuple[str, Readings]]
    variant: str = ""  # how else it may be said


@dataclass
class WordedRoom:
    """Room staff of a rehearsal, who act on a typed word; `staff` do the work in the simulated room."""

    staff: Room
    asking: Asking = plain_prompt
    alarms: Alarms = field(default_factory=Alarms)

    def announce(self, step: str) -> None:
        """Tell the staff which step is running."""
        self.staff.announce(step)

    def change_tool(self, number: int, description: str) -> None:
        """Have a tool mounted by `mount NUMBER`: the one that is due, or another by mistake."""

        def mount(arguments: Sequence[str]) -> tuple[str, Readings]:
            if len(arguments) != 1 or not arguments[0].isdecimal():
                raise ValueError(f"{MOUNT} needs the number of a tool, such as {MOUNT} {number}")
            mounted = int(arguments[0])
            self.staff.change_tool(mounted, description if mounted == number else "")
            return (f"tool {mounted} is mounted" if mounted else "no tool is mounted"), ()

        due = _Due(
            f"{MOUNT} {number}", f"mounts {description}", mount, f"{MOUNT} NUMBER mounts another tool, 0 none"
        )
        with self.asking() as write:
            say_line(f"Mount {description} (tool {number}).")
            self._have_done(write, due)

    def prepare_stand(self, holds: str) -> None:
        """Have the calibration stand prepared by `stand OBJECT`."""

        def put(arguments: Sequence[str]) -> tuple[str, Readings]:
            if (there := pick_answer(" ".join(arguments), STAND_HOLDS)) is None:
                typed = printable(" ".join(arguments))
                put_what = f"{typed!r} does not go on the stand" if typed else "nothing was named"
                raise ValueError(f"{put_what}: type {' or '.join(f'{STAND} {one}' for one in STAND_HOLDS)}")
            self.staff.prepare_stand(there)
            return f"on the stand: {there}", ()

        due = _Due(
            f"{STAND} {holds}",
            f"puts the {holds} on the stand",
            put,
            f"{STAND} {join_answers(STAND_HOLDS)} puts that there",
        )
        with self.asking() as write:
            say_line(f"Put the {holds} on the calibration stand.")
            self._have_done(write, due)

    def work(self, task: Task) -> Readings:
        """Perform the task when its command is typed and return the readings; empty if declined.

        Raises PRO-002 if nobody takes the instrument out: an `out` at the question that follows would say
        that it is, and the arm would move with it inside.
        """

        def carry_out(arguments: Sequence[str]) -> tuple[str, Readings]:
            numbers = _numbers(task, arguments)
            place = f" at {task.trajectory}" if task.trajectory else ""
            readings = self.staff.work(Task(task.name, task.subject, task.trajectory, numbers))
            return f"{task.name}{place}", readings

        variant = f"{task.name} NUMBER sets another length in mm" if task.name in SETTABLE else ""
        due = _Due(task.name, f"has it done: {task.subject}", carry_out, variant)
        with self.asking() as write:
            say_line(_as_order(task))
            shown = self._have_done(write, due)
            if shown is None and task.name == OUT:
                raise NotConfirmed(
                    f"nobody has done this: {task.subject}; nothing moves",
                    expected=f"the word {task.name}, which has it done",
                    action="Repeat the step, or use home, and type that word.",
                )
            if shown:
                what = join_reads(task.reads) or "the scales"
                say_line(f"You read off {what}: {' '.join(f'{value:g}' for value in shown)}")
            if not task.reads or shown is None:
                return ()
            return read_values(write, task, self.alarms)

    def _have_done(self, write: WritePrompt, due: _Due) -> Readings | None:
        """Wait for the word and have it done; return what the scales show, or None if nobody does it."""
        self.alarms.begin()
        choices = (due.word, NOBODY)
        while typed := read_typed(write, join_answers(choices), None, self.alarms):
            first, *arguments = typed.strip("'").split() or ("",)
            word = first.casefold()
            if pick_answer(typed, (NOBODY,)) is not None:
                say_line("Nobody does it.")
                return None
            if pick_answer(typed, (HELP,)) is not None:
                self._explain(due)
            elif word != due.word.split()[0]:
                kind = "is not due now" if word in WORDS else "is no word for manual work"
                say_line(f"{typed!r} {kind}: type {join_answers(choices)}; {HELP} explains them.")
            else:
                try:
                    done, readings = due.do(arguments)
                except (ValueError, ControlRequestRefused) as refused:
                    say_line(str(refused))
                    continue
                say_line(f"Done: {done}.")
                return readings
        return None

    @staticmethod
    def _explain(due: _Due) -> None:
        say_line(f"{due.word!r} {due.meaning}")
        if due.variant:
            say_line(due.variant)
        say_line(f"{NOBODY!r} leaves it undone, as staff may who say nothing")


def _as_order(task: Task) -> str:
    return f"{task.subject[:1].upper()}{task.subject[1:]}."


def _numbers(task: Task, arguments: Sequence[str]) -> tuple[float, ...]:
    """Return the numbers for a task: as asked, or as typed where a person sets them. Raises ValueError."""
    if not arguments:
        return task.numbers
    if task.name not in SETTABLE:
        raise ValueError(f"nothing follows {task.name}; nothing was done")
    with suppress(ValueError):
        return (parse_typed_number(" ".join(arguments), UNIT),)
    raise ValueError(f"{printable(' '.join(arguments))!r} is no length in mm; nothing was done")


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
        by_word=lambda staff: WordedRoom(staff, asking, alarms),
    )
