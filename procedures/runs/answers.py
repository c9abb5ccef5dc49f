"""The operator of a run: a file of answers, a script, a person at the terminal or the console, or several.

A file of answers is a scripted operator, for rehearsals, tests and demonstrations:

    default = "first"          # of topics not listed: their first answer, or "silence", their last
    [answers]
    registration = "yes"
    "approach:T1" = "no"

Without `default`, topics that are not listed are answered as without the file. On real devices a person
answers what a slip must not: what moves the arm or lets a result count, a pause, what is read back, and what
hands have done to the patient.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from procedures.engine.errors import AnswersUnfit
from procedures.operator.question import FOR_A_PERSON, Operator, Question, Topic, words
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.steps.catalogue import ANSWER_WORDS
from ronna_hw.bounded_input import read_toml
from ronna_hw.command_line.messages import on_terminal, tell
from ronna_hw.config import read_theatre_file
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.theatre_kind import is_simulated

if TYPE_CHECKING:
    from procedures.runs.interrupted_run import Resumption
    from procedures.runs.lifecycle import RunObservers

OTHER_FILES = {"trajectories": "a plan", "theatre": "a theatre file"}  # by a key that only they have
ALL_TOPICS = frozenset(Topic)
NOBODY_ANSWERS = (
    "warning: standard input is not a terminal, so nobody can answer questions: run at a terminal, "
    "with --console, or with --answers FILE"
)
NO_PERSON = (
    "warning: standard input is not a terminal, so nobody can answer what only a person may on real devices: "
    "run at a terminal or with --console"
)
Rule = tuple[Operator | None, Set[Topic], bool]  # who answers which topics, and whether they are there


def operator_selection(
    request: RunRequest, observers: RunObservers, resumption: Resumption | None = None
) -> Operator:
    """Select the operator of each topic, and of the topics that a file of answers does not list.

    On real devices the person answers what is deliberate or read back, whatever the file says. An operator at
    the console takes the place of all of them while the console is in charge.
    """
    answers, person, prompt = request.answers, observers.person, observers.at_pause
    configured = request.config is not None
    at_terminal = on_terminal(sys.stdin) and on_terminal(sys.stderr)
    accepted = resumption is not None and resumption.accepted
    file_answers_all = answers is not None and is_rehearsal(request.config)
    if (
        isinstance(request.procedure, CaseProcedure)  # a measurement may ask nothing
        and configured
        and not (file_answers_all or at_terminal or observers.executor or prompt)
        and (resumption is None or resumption.asks)
    ):
        tell(NOBODY_ANSWERS if answers is None else NO_PERSON)
    script = ScriptedOperator()
    without_file = _first_of(
        (
            (prompt, {Topic.PAUSE}, True),
            (script, {Topic.RESUME}, accepted),
            (person, {Topic.RESUME}, resumption is not None),
            (person, ALL_TOPICS, configured),
            (person, {Topic.PAUSE, Topic.REPEAT}, at_terminal),
            (script, ALL_TOPICS, True),  # in a simulated theatre of its own
        )
    )
    operator = without_file
    if answers is not None:
        by_file = AnsweringOperator(answers, without_file, None if file_answers_all else without_file)
        # `--accept` is the later word.
        operator = _first_of(((script, {Topic.RESUME}, accepted), (by_file, ALL_TOPICS, True)))
    if observers.executor is None:
        return operator
    in_person = on_terminal(sys.stdin) and (prompt is not None or on_terminal(sys.stderr))
    return observers.executor.operator(operator, script_at_pause=not in_person)


def _first_of(rules: Iterable[Rule]) -> Operator:
    """Return an operator by whom each topic is answered by the first rule that applies to it."""
    present = [(operator, topics) for operator, topics, applies in rules if operator is not None and applies]
    return ByTopic({topic: next(one for one, topics in present if topic in topics) for topic in Topic})


class Answers(BaseModel):
    """Content of a file of answers. Keys are a topic, or a topic and a trajectory, such as `approach:T1`."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    default: Literal["first", "silence"] | None = None
    answers: dict[str, str] = {}

    def word_for(self, question: Question) -> str | None:
        """Return the answer for the trajectory of a question if there is one, else for its topic."""
        word = self.answers.get(question.name, self.answers.get(str(question.topic)))
        return word if word in question.answers else None

    def check_trajectories(self, trajectories: Sequence[str]) -> None:
        """Raise PRO-026 for answers about trajectories that the plan does not have."""
        named = {key: key.partition(":")[2] for key in self.answers if ":" in key}
        if unknown := [key for key, name in named.items() if name not in trajectories]:
            raise AnswersUnfit(
                f"the plan has no trajectory for {', '.join(unknown)}", expected=", ".join(trajectories)
            )


def is_rehearsal(config: Path | None) -> bool:
    """Whether all devices are simulated, by a scene or by this theatre file. Raises CFG-001, OSError."""
    return config is None or is_simulated(read_theatre_file(config))


def read_answers(path: Path, config: Path | None = None) -> Answers:
    """Read a file of answers; `config` is the theatre file of the devices, if they are not of a scene.

    Raises PRO-026 with everything in it that does not fit, also for real devices, CFG-001, OSError.
    """
    content = read_toml(path, AnswersUnfit)
    for key, kind in OTHER_FILES.items():
        if key in content:
            raise AnswersUnfit(
                f"{path} is {kind}, not a file of answers", expected="a table [answers], or a default"
            )
    try:
        read = Answers.model_validate(content)
    except ValidationError as error:
        raise AnswersUnfit(f"{path}: {'; '.join(describe_mistakes(error, Answers))}") from error
    if mistakes := [mistake for key, word in read.answers.items() if (mistake := _mistake(key, word))]:
        raise AnswersUnfit(f"{path}: {'; '.join(mistakes)}")
    if (
        personal := [key for key in read.answers if key.partition(":")[0] in FOR_A_PERSON]
    ) and not is_rehearsal(config):
        raise AnswersUnfit(
            f"{path}: on real devices only a person answers {', '.join(personal)}",
            action="Remove these lines; the questions are asked at the terminal or the console.",
        )
    return read


def _mistake(key: str, word: str) -> str | None:
    name = key.partition(":")[0]
    if name not in set(Topic):
        return f"there is no topic {name!r}, only {', '.join(Topic)}"
    known = ANSWER_WORDS[Topic(name)]
    return None if word in known else f"{key} accepts {words(known)}, got {word!r}"


class ScriptedOperator:
    """Gives the first answer to every question.

    When a guard's question comes again after a wait, it is left: nobody is there to restore its condition.
    """

    def __init__(self) -> None:
        self._waited_for: set[tuple[str, str]] = set()  # guard and place

    def ask(self, question: Question) -> str:
        """Return the first answer, or silence to a guard that was waited for in vain."""
        if question.topic in (Topic.GUARD, Topic.HEAD_UNSEEN):
            what = (question.subject.partition(":")[0], question.value)
            if what in self._waited_for:
                return question.silence
            self._waited_for.add(what)
        return question.answers[0]


class SilentOperator:
    """Nobody: every question is met with silence, which never continues."""

    def ask(self, question: Question) -> str:
        """Return what silence means."""
        return question.silence


class ByTopic:
    """Has each topic answered by an operator of its own."""

    def __init__(self, operators: Mapping[Topic, Operator]) -> None:
        self._operators = operators

    def ask(self, question: Question) -> str:
        """Return the answer of the topic's operator."""
        return self._operators[question.topic].ask(question)


class AnsweringOperator:
    """Answers from a file; `otherwise` answers the rest, and `person` what only a person may."""

    def __init__(self, answers: Answers, otherwise: Operator, person: Operator | None = None) -> None:
        """Without a `person`, as in a simulated theatre, the file answers these questions as well."""
        self._answers = answers
        self._person = person
        self._otherwise = ScriptedOperator() if answers.default == "first" else otherwise

    def ask(self, question: Question) -> str:
        """Return the answer in the file, or that of the operator who answers in its place."""
        for_a_person = question.topic in FOR_A_PERSON or question.read_back is not None
        if for_a_person and self._person is not None:
            return self._person.ask(question)
        word = self._answers.word_for(question)
        if word is not None:
            return word
        return question.silence if self._answers.default == "silence" else self._otherwise.ask(question)
