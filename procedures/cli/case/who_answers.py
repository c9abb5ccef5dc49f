"""Who answers the questions of a case: a file, a script, a person at the terminal, or several of them."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from procedures.cli.case.operators import ByTopic, ScriptedOperator, TerminalOperator
from procedures.cli.case.request import CaseRequest, TheatreRequest
from procedures.operator.topic import Topic
from ronna_hw.command_line.messages import tell
from ronna_hw.command_line.terminal import on_terminal

if TYPE_CHECKING:
    from procedures.cli.case.alarms import Alarms
    from procedures.cli.case.answers import Answers
    from procedures.cli.case.opening import Watcher
    from procedures.composition.procedure import Resumption
    from procedures.operator.question import Operator

NOBODY_ANSWERS = (
    "warning: standard input is not a terminal, so nobody can answer questions: run at a terminal, "
    "with --console, or with --answers FILE"
)
NO_PERSON = (
    "warning: standard input is not a terminal, so nobody can answer what only a person may on real devices: "
    "run at a terminal or with --console"
)


def operator_of(
    request: TheatreRequest,
    watcher: Watcher,
    answers: Answers | None,
    resumption: Resumption | None = None,
    alarms: Alarms | None = None,
) -> Operator:
    """Who answers: the file of answers, then the script of a simulated case or the person at the terminal.

    On real devices the person answers what is deliberate or read back, whatever the file says. The script
    resumes a run only if it was told to accept the findings; in a simulated theatre with a theatre file that
    is all it answers.
    """
    person: Operator = TerminalOperator(watcher.asking, alarms)
    simulated = True  # a file may answer everything
    if answers is not None:
        from procedures.cli.case.answers import rehearsed

        simulated = rehearsed(request.config)
    at_terminal = on_terminal(sys.stdin) and on_terminal(sys.stderr)
    if (
        isinstance(request, CaseRequest)  # a measurement may ask nothing
        and request.config is not None
        and (answers is None or not simulated)
        and not at_terminal
        and watcher.pilot is None
        and watcher.at_pause is None
        and (resumption is None or resumption.asks)
    ):
        tell(NOBODY_ANSWERS if answers is None else NO_PERSON)
    persons: dict[Topic, Operator] = {Topic.PAUSE: person, Topic.REPEAT: person} if at_terminal else {}
    if watcher.at_pause is not None:
        persons[Topic.PAUSE] = watcher.at_pause
    if resumption is not None and not resumption.accepted:
        persons[Topic.RESUME] = person
    operator: Operator = ScriptedOperator(persons)
    if request.config is not None:
        others: dict[Topic, Operator] = {}
        if watcher.at_pause is not None:
            others[Topic.PAUSE] = watcher.at_pause
        if resumption is not None and resumption.accepted:
            others[Topic.RESUME] = ScriptedOperator()
        operator = ByTopic(others, person)
    if answers is None:
        return operator
    from procedures.cli.case.answers import AnsweringOperator

    by_file = AnsweringOperator(answers, operator, person=None if simulated else operator)
    if resumption is None or not resumption.accepted:
        return by_file
    return ByTopic({Topic.RESUME: ScriptedOperator()}, by_file)  # `--accept` is the later word
