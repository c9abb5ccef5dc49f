"""Non-interactive operators: answers from a file, always the first answer, or silence.

A file of answers is a scripted operator, for rehearsals, tests and demonstrations:

    default = "first"          # of topics not listed: their first answer, or "silence", their last
    [answers]
    registration = "yes"
    "approach:T1" = "no"

Without `default`, topics that are not listed are answered as without the file. On real devices a person
answers what no slip may decide: motions, validity of results, pauses, read-back values, work on the patient.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from itertools import islice
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ValidationError

from procedures.engine.errors import ANSWERS_UNFIT
from procedures.operator.question import (
    FOR_A_PERSON,
    OF_THE_CASE,
    Answer,
    Operator,
    Question,
    Topic,
    join_answers,
)
from ronna_hw.bounded_input import read_toml
from ronna_hw.config import read_theatre_file
from ronna_hw.mistakes import describe_mistakes, find_other_kind
from ronna_hw.near_names import find_near
from ronna_hw.theatre_kind import is_simulated

Rule = tuple[Operator | None, Set[Topic], bool]  # who answers which topics, and whether they are there
MOST_MISTAKES = 20  # told at once


class Answers(BaseModel, frozen=True, extra="forbid", strict=True):
    """Contents of an answers file. Each key is a topic or `topic:trajectory`, such as `approach:T1`."""

    default: Literal["first", "silence"] | None = None
    answers: dict[str, str] = {}

    def answer_for(self, question: Question) -> str | None:
        """Return the file's answer to a question, or None. An answer for its trajectory takes precedence."""
        key = self.key_for(question)
        return None if key is None else self.answers[key]

    def key_for(self, question: Question) -> str | None:
        """Return the key of the file's answer to a question, or None."""
        key = question.name if question.name in self.answers else str(question.topic)
        return key if self.answers.get(key) in question.answers else None

    def check_trajectories(self, trajectories: Sequence[str]) -> None:
        """Raise PRO-026 for answers whose trajectory is not in the plan."""
        named = {key: key.partition(":")[2] for key in self.answers if ":" in key}
        if unknown := [key for key, name in named.items() if name not in trajectories]:
            raise ANSWERS_UNFIT(
                f"the plan has no trajectory for {', '.join(unknown)}", expected=", ".join(trajectories)
            )


def is_rehearsal(config: Path | None) -> bool:
    """Whether all devices are simulated, by a scene or by the theatre file. Raises CFG-001, OSError."""
    return config is None or is_simulated(read_theatre_file(config))


def read_answers(path: Path, config: Path | None = None) -> Answers:
    """Read an answers file; `config` is the theatre file, or None for a simulated scene.

    Raises PRO-026 with everything in it that does not fit, also for real devices, CFG-001.
    """
    try:
        content = read_toml(path, ANSWERS_UNFIT)
    except OSError as error:
        raise ANSWERS_UNFIT(
            f"--answers: cannot read {path}: {str(error.strerror).lower()}",
            expected="a TOML file with a table [answers]",
            action="Correct the path, or omit --answers.",
        ) from error
    if kind := find_other_kind(content, "answers"):
        raise ANSWERS_UNFIT(
            f"{path} is {kind}, not a file of answers",
            expected="a table [answers], or a default",
            action="Give a file of answers; docs/reference/answers.md shows one.",
        )
    try:
        read = Answers.model_validate(content)
    except ValidationError as error:
        raise ANSWERS_UNFIT(f"{path}: {'; '.join(describe_mistakes(error, Answers))}") from error
    found = (_find_mistake(key, word) for key, word in read.answers.items())
    if mistakes := list(islice(filter(None, found), MOST_MISTAKES)):
        raise ANSWERS_UNFIT(f"{path}: {'; '.join(mistakes)}")
    personal = [key for key in read.answers if key.partition(":")[0] in FOR_A_PERSON]
    if personal and not is_rehearsal(config):
        raise ANSWERS_UNFIT(
            f"{path}: on real devices only a person answers {', '.join(personal)}",
            action="Remove these lines; the questions are asked at the terminal or the console.",
        )
    return read


def _find_mistake(key: str, word: str) -> str | None:
    from procedures.steps.catalogue import ANSWER_WORDS  # it has all steps: not for a script without a file

    name = key.partition(":")[0]
    if name not in set(Topic):
        if near := find_near(name, Topic):
            return f"there is no topic {name!r} (did you mean '{near[0]}'?)"
        return f"there is no topic {name!r}, only {', '.join(Topic)}"
    if ":" in key and Topic(name) in OF_THE_CASE:
        return f"{key}: the question is asked once for the case, not for a trajectory; write {name}"
    known = ANSWER_WORDS[Topic(name)]
    if word in known:
        return None
    meant = "".join(f" (did you mean {near!r}?)" for near in find_near(word, known))
    return f"{key} accepts {join_answers(known)}, got {word!r}{meant}"


class ScriptedOperator:
    """Operator that gives the first answer to every question.

    A guard's question that comes again after a wait is left: nobody can restore its condition.
    """

    def __init__(self) -> None:
        self._waited_for: set[tuple[str, str]] = set()  # guard and place

    def ask(self, question: Question) -> Answer:
        """Return the first answer, or silence if a guard asks again after a wait."""
        if question.topic in (Topic.GUARD, Topic.HEAD_UNSEEN):
            what = (question.subject.partition(":")[0], question.value)
            if what in self._waited_for:
                return Answer(question.silence)
            self._waited_for.add(what)
        return Answer(question.answers[0])


class AcceptingOperator:
    """Script that accepts the findings of a resumed run and tells each of them."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell

    def ask(self, question: Question) -> Answer:
        """Tell each statement, then return the first answer."""
        for finding in question.value.splitlines():
            self._tell(f"accepted: {finding}")
        return Answer(question.answers[0])


class SilentOperator:
    """Operator that answers no question. Silence never lets a case continue."""

    def ask(self, question: Question) -> Answer:
        """Return the answer that the question assigns to silence."""
        return Answer(question.silence)


class OperatorByTopic:
    """Operator that leaves each topic to the first rule that covers it."""

    def __init__(self, *rules: Rule) -> None:
        """Leave each topic to a rule that applies; raises ValueError for one that none covers."""
        present = [(one, topics) for one, topics, applies in rules if one is not None and applies]
        covered = frozenset(topic for _, topics in present for topic in topics)
        if uncovered := [topic for topic in Topic if topic not in covered]:
            raise ValueError(f"nobody answers {', '.join(uncovered)}")
        self._operators = {topic: next(one for one, topics in present if topic in topics) for topic in Topic}

    def ask(self, question: Question) -> Answer:
        """Ask the operator responsible for the topic."""
        return self._operators[question.topic].ask(question)


class AnsweringOperator:
    """Operator that answers from a file, leaving personal questions to `person` and others to `fallback`."""

    def __init__(
        self,
        answers: Answers,
        fallback: Operator,
        person: Operator | None = None,
        tell: Callable[[str], None] = lambda _text: None,
    ) -> None:
        """Without `person`, as in a simulated theatre, the file also answers personal questions.

        `tell` is called when the file does not let the case go on.
        """
        self._answers, self._tell = answers, tell
        self._person = person
        self._otherwise = ScriptedOperator() if answers.default == "first" else fallback

    def ask(self, question: Question) -> Answer:
        """Return the file's answer if it may and does answer, or else ask the person or the fallback."""
        for_a_person = question.topic in FOR_A_PERSON or question.read_back is not None
        if for_a_person and self._person is not None:
            return self._person.ask(question)
        word = self._answers.answer_for(question)
        if word is None and self._answers.default == "silence":
            word = question.silence
        if word is None:
            return self._otherwise.ask(question)
        if word != question.answers[0]:
            key = self._answers.key_for(question)
            line = f'default = "{self._answers.default}"' if key is None else f'"{key}" = "{word}"'
            self._tell(f"the file of answers says {word} to {question.name}, by its line {line}")
        return Answer(word)
