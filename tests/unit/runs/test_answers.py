"""An operator scripted by a file: valid answers are used, invalid ones are refused before anything starts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest
from coded_errors import raises
from recording_cell import mini_theatre_file

from procedures.engine.errors import ANSWERS_UNFIT
from procedures.operator.question import Answer, Question, ReadBack, Topic
from procedures.runs.answers import AnsweringOperator, Answers, read_answers
from procedures.runs.interrupted_run import InterruptedRun, Resumption
from procedures.runs.observers import RunObservers, operator_selection
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.steps.catalogue import ANSWER_WORDS

APPROACH = Question(Topic.APPROACH, "move to T1", "10 mm", trajectory="T1")


class Person:
    def ask(self, question: Question) -> Answer:
        return Answer("person")


def answered(question: Question, **content: object) -> str:
    return AnsweringOperator(Answers.model_validate(content), Person()).ask(question).word


def test_an_answer_for_one_trajectory_takes_precedence_over_the_general_one() -> None:
    assert answered(APPROACH, answers={"approach:T1": "no", "approach": "yes"}) == "no"
    assert answered(APPROACH, answers={"approach:T2": "no", "approach": "yes"}) == "yes"


def test_a_file_that_does_not_let_the_case_go_on_is_named_as_the_one_that_said_so() -> None:
    told: list[str] = []
    for word in ("yes", "no"):
        answers = Answers(answers={"approach": word})
        AnsweringOperator(answers, Person(), tell=told.append).ask(APPROACH)
    assert told == ['the file of answers says no to approach:T1, by its line "approach" = "no"']


@pytest.mark.parametrize(("default", "answer"), [("first", "yes"), ("silence", "no"), (None, "person")])
def test_an_unlisted_question_is_answered_by_the_default_of_the_file(
    default: str | None, answer: str
) -> None:
    assert answered(APPROACH, default=default) == answer


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[answers]\nlunch = 'yes'", "lunch"),
        ("[answers]\napproach = 'perhaps'", "perhaps"),
        ("[answers]\n'patient:T1' = 'no'", "write patient"),
        ("[answers]\n'approach:T1' = 'Y'", "yes or no"),
        ("[answers]\napproach = true", "answers.approach"),
        ("default = 'second'", "default"),
        ("colour = 'green'", "colour"),
        ("schema = 1\n[[trajectories]]\nid = 'T1'", r"answers\.toml is a plan, not a file of answers; exp"),
        ("schema = 1\ntheatre = 'lab'", r"answers\.toml is a theatre file, not a file of answers; exp"),
        ("[answers", "TOML"),
        ("\xff\xfe", "TOML"),
    ],
)
def test_invalid_answers_are_refused_and_named(tmp_path: Path, text: str, named: str) -> None:
    path = tmp_path / "answers.toml"
    path.write_bytes(text.encode("latin-1"))
    with raises(ANSWERS_UNFIT, match=named):
        read_answers(path)


def test_a_trajectory_that_is_not_in_the_plan_is_refused() -> None:
    answers = Answers(answers={"approach:T9": "no"})
    with raises(ANSWERS_UNFIT, match="approach:T9"):
        answers.check_trajectories(("T1", "T2"))


def test_every_topic_has_its_words() -> None:
    assert set(ANSWER_WORDS) == set(Topic)


@pytest.mark.hazard(36)
def test_a_file_does_not_answer_a_question_with_a_read_back() -> None:
    moves = replace(APPROACH, read_back=ReadBack("how many mm", "10"))
    patient = replace(moves, topic=Topic.PATIENT)
    operator = AnsweringOperator(Answers(default="first", answers={"patient": "yes"}), Person(), Person())
    assert [operator.ask(question).word for question in (moves, patient)] == ["person", "person"]


@pytest.mark.hazard(36)
@pytest.mark.parametrize("default", ["first", "silence"])
@pytest.mark.parametrize(
    "topic", [Topic.RESUME, Topic.INSTRUMENT_OUT, Topic.PAUSE, Topic.HEAD_UNSEEN, Topic.DRILL]
)
def test_on_real_devices_a_file_answers_no_question_that_a_person_must(topic: Topic, default: str) -> None:
    answers = Answers.model_validate({"default": default, "answers": {str(topic): "yes"}})
    question = Question(topic, "go on", "the arm moves")
    assert AnsweringOperator(answers, Person(), person=Person()).ask(question).word == "person"
    tool = Question(Topic.TOOL_CHANGE, "mount the guide", "tool 2")
    assert AnsweringOperator(answers, Person(), person=Person()).ask(tool).word != "person"


@pytest.mark.hazard(36)
def test_a_pause_on_real_devices_is_answered_where_it_is_asked_without_a_file(tmp_path: Path) -> None:
    request = RunRequest(
        procedure=CaseProcedure(case=tmp_path), config=mini_theatre_file(tmp_path, simulated=False)
    )
    operator = operator_selection(
        replace(request, answers=Answers(default="first")), RunObservers(at_pause=Person())
    )
    assert operator.ask(Question(Topic.PAUSE, "Paused", "here", ("continue", "abort"))).word == "person"


@pytest.mark.hazard(36)
def test_a_file_for_real_devices_that_answers_for_the_person_is_refused_when_it_is_read(
    tmp_path: Path,
) -> None:
    path = tmp_path / "answers.toml"
    path.write_text("[answers]\ntool_change = 'yes'\n'instrument_out:T1' = 'out'\nresume = 'yes'\n")
    with raises(ANSWERS_UNFIT, match="only a person answers instrument_out:T1, resume"):
        read_answers(path, mini_theatre_file(tmp_path, simulated=False))
    assert len(read_answers(path, mini_theatre_file(tmp_path, simulated=True)).answers) == 3
    assert len(read_answers(path).answers) == 3


@pytest.mark.hazard(36)
@pytest.mark.parametrize(("simulated", "answer"), [(True, "yes"), (False, "no")])
def test_a_file_confirms_no_motion_of_a_real_arm(tmp_path: Path, simulated: bool, answer: str) -> None:
    path = mini_theatre_file(tmp_path, simulated=simulated)
    request = RunRequest(procedure=CaseProcedure(case=tmp_path), config=path)
    moves = replace(APPROACH, read_back=ReadBack("how many mm", "10"))
    assert (
        operator_selection(replace(request, answers=Answers(default="first")), RunObservers()).ask(moves).word
        == answer
    )


@pytest.mark.parametrize("by_file", [None, Answers(default="silence"), Answers(answers={"resume": "no"})])
@pytest.mark.parametrize(("accepted", "answers"), [(True, ["yes", "no"]), (False, ["no", "no"])])
def test_the_accept_option_answers_for_the_findings_only_and_comes_before_a_file(
    tmp_path: Path, accepted: bool, answers: list[str], by_file: Answers | None
) -> None:
    path = mini_theatre_file(tmp_path, simulated=True)
    left = cast(InterruptedRun, None)  # not looked at
    request = RunRequest(procedure=CaseProcedure(case=tmp_path), config=path)
    told: list[str] = []
    operator = operator_selection(
        replace(request, answers=by_file), RunObservers(announce=told.append), Resumption(left, accepted)
    )
    findings = Question(Topic.RESUME, "resume the case", "no differences")
    assert [operator.ask(question).word for question in (findings, APPROACH)] == answers
    assert ("accepted: no differences" in told) is accepted


@pytest.mark.parametrize(("at_terminal", "answer"), [(True, "no"), (False, "yes")])
def test_a_step_is_repeated_without_asking_only_when_nobody_is_at_the_terminal(
    monkeypatch: pytest.MonkeyPatch, at_terminal: bool, answer: str
) -> None:
    """Whoever sits at this terminal says nothing."""
    monkeypatch.setattr("procedures.runs.observers.on_terminal", lambda _stream: at_terminal)
    operator = operator_selection(RunRequest(procedure=CaseProcedure()), RunObservers())
    assert operator.ask(Question(Topic.REPEAT, "repeat image", "supersedes 01-image")).word == answer


@pytest.mark.parametrize(("ask", "answer"), [(False, "yes"), (True, "person")])
def test_a_simulated_case_is_answered_by_a_script_and_says_so_unless_a_person_is_to_be_asked(
    ask: bool, answer: str
) -> None:
    said: list[str] = []
    observers = RunObservers(announce=said.append, person=Person())
    operator = operator_selection(RunRequest(procedure=CaseProcedure(), ask=ask), observers)
    for topic in (Topic.APPROACH, Topic.REGISTRATION, Topic.TOOL_CHANGE):
        assert operator.ask(Question(topic, "what", "how much")).word == answer
    (line,) = said
    assert line.startswith("every question of a real case is asked here" if ask else "a script answers")


@pytest.mark.parametrize(
    ("at_terminal", "asks", "said"),
    [(True, True, ""), (False, True, "nobody can answer"), (False, False, "")],
)
def test_a_case_on_a_theatre_file_without_a_terminal_warns_that_nobody_can_answer_if_it_asks(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    at_terminal: bool,
    asks: bool,
    said: str,
) -> None:
    monkeypatch.setattr("procedures.runs.observers.on_terminal", lambda _stream: at_terminal)
    request = RunRequest(procedure=CaseProcedure(case=tmp_path), config=tmp_path / "theatre.toml")
    left = cast(InterruptedRun, None)  # not looked at
    acknowledging = None if asks else Resumption(left, accepted=False, only_leaving=True, asks=False)
    operator_selection(request, RunObservers(), acknowledging)
    error = capsys.readouterr().err
    assert said in error if said else error == ""
