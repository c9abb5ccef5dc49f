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
    from procedures.cli.case.answers import Answers
    from procedures.cli.case.opening import Watcher
    from procedures.operator.question import Operator
    from procedures.session.procedure import Resumption

NOBODY_ANSWERS = (
    "warning: standard input is not a terminal, so nobody can answer questions: run at a terminal, "
    "with --console, or with --answers FILE"
)


def operator_of(
    request: TheatreRequest,
    watcher: Watcher,
    answers: Answers | None,
    resumption: Resumption | None = None,
) -> Operator:
    """Who answers: the file of answers, then the script of a simulated case or the person at the terminal.

    On real devices the person reads values back, whatever the file says. The script resumes a run only if
    it was told to accept the findings; in a simulated theatre with a theatre file that is all it answers.
    """
    person: Operator = TerminalOperator(watcher.asking)
    at_terminal = on_terminal(sys.stdin) and on_terminal(sys.stderr)
    if (
        isinstance(request, CaseRequest)  # a measurement may ask nothing
        and request.config is not None
        and answers is None
        and not at_terminal
        and watcher.pilot is None
        and watcher.at_pause is None
        and (resumption is None or resumption.asks)
    ):
        tell(NOBODY_ANSWERS)
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
    from ronna_hw.config import read_theatre_file
    from ronna_hw.theatre_kind import is_simulated

    rehearsed = request.config is None or is_simulated(read_theatre_file(request.config))
    return AnsweringOperator(answers, operator, reads_back=None if rehearsed else person)
