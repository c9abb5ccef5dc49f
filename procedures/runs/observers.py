"""People and displays that follow a run, and the choice of the operator for each topic."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

from procedures.operator.question import Operator, Room, Task, Topic
from procedures.runs.answers import (
    AcceptingOperator,
    AnsweringOperator,
    OperatorByTopic,
    ScriptedOperator,
    SilentOperator,
    is_rehearsal,
)
from procedures.runs.request import CaseProcedure, RunRequest
from ronna_hw.command_line.messages import on_terminal, tell
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from pathlib import Path

    from procedures.engine.engine import Engine
    from procedures.runs.interrupted_run import Resumption
    from procedures.runs.order_executor import OrderExecutor

ALL_TOPICS = frozenset(Topic)
NOBODY_ANSWERS = (
    "warning: standard input is not a terminal, so nobody can answer questions: run at a terminal, "
    "with --console, or with --answers FILE"
)
NO_PERSON = (
    "warning: standard input is not a terminal, so nobody can answer what only a person may on real devices: "
    "run at a terminal or with --console"
)
NOBODY_ACCEPTS = (
    "warning: standard input is not a terminal, so nobody can accept what was found: run at a terminal, "
    "with --accept, or with --answers FILE"
)
ASKED = "every question of a real case is asked here; manual work is done by the word that is asked for"
ASKED_AT_CONSOLE = (
    "questions are asked at the console; manual work is done here, by the word that is asked for"
)
SEAT_AWAITED = "waiting until someone takes the operator's seat at the console"


class HeldPrompt(Protocol):
    """A prompt at which a person decides how a held case continues."""

    def tell_held(self, engine: Engine, error: RonnaError) -> None:
        """Show why the case is held and how it can continue."""
        ...

    def follow(self, engine: Engine) -> bool:
        """Execute commands until the case continues (True) or is left (False)."""
        ...


class UnattendedRoom:
    """Room without staff; tasks yield no readings."""

    def announce(self, step: str) -> None:
        """Do nothing, because nobody listens."""

    def change_tool(self, number: int, description: str) -> None:
        """Do nothing; the step itself asks to confirm the mounted tool."""

    def prepare_stand(self, holds: str) -> None:
        """Do nothing; the step itself asks to confirm the prepared stand."""

    def work(self, task: Task) -> tuple[float, ...]:
        """Return no readings."""
        return ()


@dataclass(frozen=True)
class RunObservers:
    """People and displays that follow a run."""

    status: Callable[[str], None] = lambda _text: None  # of what is done before there is an engine
    announce: Callable[[str], None] = lambda _text: None  # a simulated theatre's control port and pendant
    patient: Callable[[Path], None] = lambda _folder: None  # a simulated one, whose CT has just been made
    opened: Callable[[Engine], None] = lambda _engine: None  # before the first step
    person: Operator = field(default_factory=SilentOperator)  # at the terminal
    staff: Callable[[bool], Room] = lambda _simulated: UnattendedRoom()  # of a configured theatre
    by_word: Callable[[Room], Room] = lambda staff: staff  # of a simulated theatre, told by a person's words
    held: HeldPrompt | None = None  # without one a held case ends
    at_pause: Operator | None = None  # who answers a pause, if not the person
    executor: OrderExecutor | None = None  # of a console that operates the case
    script: Operator = field(default_factory=ScriptedOperator)  # in a simulated theatre without a person


def operator_selection(
    request: RunRequest, observers: RunObservers, resumption: Resumption | None = None
) -> Operator:
    """Select the operator for each topic, including topics missing from the answers file.

    On real devices the person answers deliberate and read-back questions, whatever the file says. While the
    console is in charge, its operator replaces all of them.
    """
    answers, person, prompt = request.answers, observers.person, observers.at_pause
    if request.ask:
        observers.announce(ASKED if observers.executor is None else ASKED_AT_CONSOLE)
    elif not request.has_person:
        observers.announce(_describe_script(request, observers, resumption))
    at_terminal = on_terminal(sys.stdin) and on_terminal(sys.stderr)
    accepted = resumption is not None and resumption.accepted
    file_answers_all = answers is not None and is_rehearsal(request.config)
    nobody_is_there = not (at_terminal or observers.executor or prompt)
    if nobody_is_there and (resumption is None or resumption.asks):
        is_case = isinstance(request.procedure, CaseProcedure)  # a measurement may ask nothing
        if is_case and request.config is not None and not file_answers_all:
            tell(NOBODY_ANSWERS if answers is None else NO_PERSON)
        elif resumption is not None and not (accepted or answers):
            tell(NOBODY_ACCEPTS)
    accepting = AcceptingOperator(observers.announce)
    operator = without_file = OperatorByTopic(
        (prompt, {Topic.PAUSE}, True),
        (accepting, {Topic.RESUME}, accepted),
        (person, {Topic.RESUME}, resumption is not None),
        (person, ALL_TOPICS, request.has_person),
        (person, {Topic.PAUSE, Topic.REPEAT}, at_terminal),
        (observers.script, ALL_TOPICS, True),  # in a simulated theatre of its own
    )
    if answers is not None:
        nobody = None if file_answers_all else without_file
        by_file = AnsweringOperator(answers, without_file, nobody, observers.announce)
        # `--accept` is the later word.
        operator = OperatorByTopic((accepting, {Topic.RESUME}, accepted), (by_file, ALL_TOPICS, True))
    if observers.executor is None:
        return operator
    person_present = on_terminal(sys.stdin) and (prompt is not None or on_terminal(sys.stderr))
    return observers.executor.operator(operator, script_at_pause=not person_present)


def _describe_script(request: RunRequest, observers: RunObservers, resumption: Resumption | None) -> str:
    """Return the first line of a rehearsal without a person: who answers in it."""
    by_file = "" if request.answers is None else " that the file of answers leaves"
    until = "" if observers.executor is None else " until somebody takes the operator's seat"
    hint = "; --ask asks you" if resumption is None else ""
    return f"a script answers the questions{by_file} and does the manual work{until}{hint}"
