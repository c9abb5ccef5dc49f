"""Wrong arguments of `run_case` are refused with the value and what was expected, before anything is run."""

from __future__ import annotations

from pathlib import Path

import pytest
from coded_errors import raises

from procedures import from_python
from procedures.from_python import FunctionOperator, run_case
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Question, Topic
from ronna_hw.arguments import WrongArgument


@pytest.mark.filterwarnings("ignore:NumPy was loaded")
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seed": "x"}, "seed of run_case; expected a whole number, got 'x'"),
        ({"seed": "7"}, "seed of run_case; expected a whole number, got '7'"),
        ({"seed": True}, "seed of run_case; expected a whole number, got True"),
        ({"dual": "no"}, "dual of run_case; expected True or False, got 'no'"),
        ({"options": {"seed": 3}}, "options of run_case has seed, which is an argument.* seed=3"),
        ({"markers": 4}, r"no argument markers; .* go into options=.\"markers\": 4"),
        ({"strategi": "ocs"}, "no argument strategi; .* Did you mean strategy"),
        ({"arm": "ur10"}, "arm of run_case; expected 'kr6', 'ur5' or 'ur5e', got 'ur10'"),
        ({"answers": lambda: "yes"}, "no function of a question; .* cannot be called with one: too many"),
        ({"answers": "yes"}, "no function of a question; .*got 'yes'"),
        ({"faults": 5}, "no lines of a fault script; expected one line or several.*got 5"),
        ({"faults": ["tracker bump", 5]}, "no lines of a fault script"),
    ],
)
def test_a_wrong_argument_is_refused_with_its_value_and_the_expectation(
    tmp_path: Path, given: dict[str, object], said: str
) -> None:
    with raises(WrongArgument, match=said):
        run_case("mini", out=tmp_path / "runs", progress=False, **given)  # type: ignore[arg-type]
    assert not (tmp_path / "runs").exists()


def test_arguments_by_place_beyond_scene_and_seed_are_refused(tmp_path: Path) -> None:
    with raises(WrongArgument, match="too many positional arguments; .* everything else by name"):
        run_case("mini", 7, "nos")  # type: ignore[call-arg]


def test_a_no_of_the_function_is_told_as_its_answer_and_other_errors_are_left_as_they_are() -> None:
    question = Question(Topic.PATIENT, "this is the patient", "Miller")
    operator = FunctionOperator(lambda _question: "no")
    assert operator.ask(question).word == "no"
    refused = NotConfirmed("the operator did not confirm")
    assert "returned 'no' to patient; to go on, it returns None" in str(operator.explain(refused))
    assert operator.explain(other := WrongArgument("another")) is other
    assert FunctionOperator(None).explain(refused) is refused


def test_an_error_of_the_function_names_the_question_and_upper_case_answers_too() -> None:
    def raising(_question: Question) -> str:
        raise KeyError("limit")

    question = Question(Topic.PATIENT, "this is the patient", "Miller")
    with pytest.raises(KeyError) as raised:
        FunctionOperator(raising).ask(question)
    assert raised.value.__notes__ == ["raised by the function of answers= at the question patient"]
    assert FunctionOperator(lambda _question: "YES").ask(question).word == "yes"


def refuse_twice(out: Path) -> None:
    for _ in range(2):
        with raises(WrongArgument):
            run_case("mini", out=out, progress=False, seed=-1)


def test_many_threads_are_warned_of_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(from_python.THREADS, raising=False)
    from_python._warn_of_threads.cache_clear()
    with pytest.warns(RuntimeWarning) as told:
        refuse_twice(tmp_path / "runs")
    assert [one.filename for one in told] == [__file__]
