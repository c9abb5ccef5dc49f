"""Hazards 9 and 36: only a listed word, in full and in time, answers; motions and patient are read back."""

from __future__ import annotations

import io
import os
import pty
import re
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from recording_cell import RecordingCell

from procedures.cli.case.operators import Alarms, TerminalOperator
from procedures.cli.case.prompt import Prompt
from procedures.cli.case.staff import TerminalRoom
from procedures.engine.engine import Engine
from procedures.engine.events import EventStream
from procedures.engine.questions import Questions
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.checkpoint import ABORT
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import (
    MISREAD_REASON,
    Answer,
    Identity,
    PredictedError,
    Question,
    ReadBack,
    Task,
    Topic,
)
from procedures.runs.operator_station import EMPTY_SEAT, OperatorStation
from ronna_hw.wire.room_tasks import DIALS

READ_BACK = ReadBack("how many mm it moves first", "62")
VALUE = "predicted target error 0.21 mm rms"


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A terminal as standard input; what is written to the descriptor is typed."""
    primary, secondary = pty.openpty()
    with os.fdopen(secondary, "r") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        yield primary
    os.close(primary)


class Screen(io.StringIO):
    """Standard error that a person reads: a line is typed each time that the prompt stands there."""

    def __init__(self, keyboard: int, *typed: bytes) -> None:
        super().__init__()
        self._keyboard, self._typed = keyboard, list(typed)

    @property
    def prompts(self) -> int:
        return self.getvalue().count("Type yes or no: ")

    def flush(self) -> None:
        if self.getvalue().endswith(": ") and self._typed:
            os.write(self._keyboard, self._typed.pop(0))


def ask(timeout_s: float = 5.0, read_back: ReadBack | None = None) -> str:
    question = Question(Topic.APPROACH, "over T1", VALUE, timeout_s=timeout_s, read_back=read_back)
    return TerminalOperator().ask(question).word


@pytest.mark.hazard(36)
def test_no_answer_in_time_counts_as_no_and_the_time_limit_is_shown(
    keyboard: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ask(timeout_s=0.05) == "no"
    assert capsys.readouterr().err.endswith("Type yes or no: \nNo answer within 0.05 s counts as 'no'.\n")


@pytest.mark.hazard(36)
def test_a_question_that_nobody_answered_in_time_is_named_without_its_value(
    keyboard: int, tmp_path: Path
) -> None:
    cell = RecordingCell(tmp_path)
    cell.operator = TerminalOperator()
    questions = Questions(cell.setting(), cell.journal, EventStream(lambda: 0.0))
    with pytest.raises(NotConfirmed) as late:
        questions.ask_in_time(Question(Topic.APPROACH, "over T1", VALUE, timeout_s=0.05))
    assert late.value.summary == "no answer within 0.05 s to 'over T1'"


def test_a_question_that_ends_at_the_console_names_what_counted_as_no(tmp_path: Path) -> None:
    cell, station = RecordingCell(tmp_path), OperatorStation(waits=True)
    cell.operator = SimpleNamespace(ask=station.ask)
    questions = Questions(cell.setting(), cell.journal, EventStream(lambda: 0.0))
    with pytest.raises(NotConfirmed) as late:
        questions.ask_in_time(Question(Topic.PATIENT, "the right patient", VALUE, timeout_s=0.05))
    assert late.value.summary == f"no answer within 0.05 s ({EMPTY_SEAT}) to 'the right patient'"
    cell.operator = SimpleNamespace(ask=lambda _asked: Answer("no", silence_reason=MISREAD_REASON))
    questions = Questions(cell.setting(), cell.journal, EventStream(lambda: 0.0))
    with pytest.raises(NotConfirmed, match=f"{MISREAD_REASON} to 'the right patient'"):
        questions.ask_in_time(Question(Topic.PATIENT, "the right patient", VALUE))


@pytest.mark.hazard(36)
@pytest.mark.parametrize("typed", [b"\n", b"y\n", b"ok\n", b"stop\n", b"yes please\n"])
def test_an_answer_that_is_not_a_listed_word_is_asked_for_again(
    keyboard: int, typed: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, typed, b"no\n"))
    assert ask() == "no"
    assert screen.prompts == 2
    assert "is not an answer: type yes or no in full" in screen.getvalue() or typed == b"\n"


@pytest.mark.hazard(36)
def test_answers_of_several_words_are_shown_in_quotes_and_may_be_typed_with_them(
    keyboard: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, b"placed\n", b"'placed again'\n"))
    answers = ("placed again", "as it stands", "hold")
    question = Question(Topic.CART_PLACE, "the cart", "12 mm off", answers, timeout_s=5.0)
    assert TerminalOperator().ask(question).word == "placed again"
    assert screen.getvalue().count("Type 'placed again', 'as it stands' or hold: ") == 2


@pytest.mark.hazard(36)
@pytest.mark.parametrize(
    ("typed", "timeout_s", "read_back", "answer", "shown"),
    [
        ([b"yes\n"], 5.0, None, "yes", VALUE),
        ([b"yes\n", b" 62\n"], 5.0, READ_BACK, "yes", VALUE),
        ([b"yes\n"] * 50, 5.0, READ_BACK, "no", "3 wrong values count as 'no'.\n"),
        ([b"yes\n"], 0.1, READ_BACK, "no", VALUE),
        ([b"yes\x04"], 0.05, None, "no", VALUE),
    ],
    ids=["yes", "yes and distance", "yes to everything", "no distance in time", "no end of line in time"],
)
def test_a_motion_is_confirmed_by_a_yes_and_its_distance_in_time_once_the_value_was_shown(
    keyboard: int,
    monkeypatch: pytest.MonkeyPatch,
    typed: list[bytes],
    timeout_s: float,
    read_back: ReadBack | None,
    answer: str,
    shown: str,
) -> None:
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, *typed))
    assert ask(timeout_s, read_back) == answer
    assert shown in screen.getvalue()


@pytest.mark.hazard(36)
def test_a_yes_typed_before_the_question_appears_is_ignored(keyboard: int) -> None:
    os.write(keyboard, b"yes\n")
    assert ask(timeout_s=0.2) == "no"


@pytest.mark.hazard(36)
def test_nothing_is_confirmed_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    os.write(writer, b"yes\n")
    os.close(writer)
    with os.fdopen(reader, "r") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        assert ask() == "no"


@pytest.mark.hazard(36)
def test_a_wrong_read_back_is_shown_and_recorded_without_the_typed_text(
    keyboard: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    typed = (b"YES\n", b"63\n", b"no\n")
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, *typed))
    cell = RecordingCell(tmp_path)
    events = EventStream(lambda: 0.0)
    cell.operator = TerminalOperator()
    questions = Questions(cell.setting(), cell.journal, events)
    assert questions.ask(Question(Topic.APPROACH, "over T1", VALUE, read_back=READ_BACK)).word == "no"
    assert f"'63' {READ_BACK.wrong}. Type it again, or no to stop; 2 tries left.\n" in screen.getvalue()
    misread, asked = read_journal(cell.folder / JOURNAL_FILE)
    assert (misread["entry"], asked["entry"]) == ("misread", "confirmation")
    assert "63" not in misread.values()


def test_what_decides_a_registration_is_bold_on_a_terminal_and_the_identity_is_shown(
    keyboard: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, b"no\n"))
    monkeypatch.setattr(screen, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    asked = Question(
        Topic.REGISTRATION,
        "accept the registration for T1",
        "predicted target error 0.22 mm rms against a margin of 2 mm",
        predicted=(PredictedError(target="T1", rms_mm=0.22, limit_mm=0.4, confidence=0.95, margin_mm=2.0),),
        identity=Identity(rows=(("name", "Phantom, Head"),)),
    )
    assert TerminalOperator().ask(asked).word == "no"
    shown = screen.getvalue().partition("Type ")[0].replace("\x1b[1m", "<").replace("\x1b[0m", ">")
    assert shown == (
        "Answers count in full, in upper or lower case; help explains those of a question.\n"
        "accept the registration for T1\n  name: Phantom, Head\n"
        "  predicted target error <0.22 mm rms> against a <margin of 2 mm>\n"
        "  within the margin; 95% of such errors stay within 0.40 mm\n"
    )


@pytest.mark.hazard(9)
def test_three_wrong_values_read_back_count_as_no(keyboard: int, monkeypatch: pytest.MonkeyPatch) -> None:
    typed = (b"yes\n", *[b"mini-5\n"] * 3)
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, *typed, b"62\n"))
    assert ask(30.0, READ_BACK) == "no"
    assert screen.getvalue().endswith(f"'mini-5' {READ_BACK.wrong}. 3 wrong values count as 'no'.\n")
    left = re.findall(r"Type it again, or no to stop; (\d tr(?:y|ies)) left", screen.getvalue())
    assert left == ["2 tries", "1 try"]


@pytest.mark.hazard(9)
def test_after_a_wrong_value_the_right_one_counts_and_neither_help_nor_a_command_is_a_try(
    keyboard: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    typed = (b"quit\n", b"yes\n", b"63\n", *[b"help\n", b"next\n"] * 2, b"64\n", b"62\n")
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, *typed))
    assert ask(5.0, READ_BACK) == "yes"
    shown = screen.getvalue()
    assert screen.prompts == 2
    assert shown.count("left.\n") == 2
    assert shown.count("ype how many mm it moves first, or no to stop.") == 4
    assert shown.count("Ctrl-C twice ends the command.\n") == 5


class ReadScreen(Screen):
    """A screen on which the arm stops as the first prompt appears."""

    def __init__(self, keyboard: int, faults: dict[str, str], *typed: bytes) -> None:
        super().__init__(keyboard, *typed)
        self._faults = faults

    def flush(self) -> None:
        super().flush()
        if self.getvalue().endswith(": "):
            self._faults["arm"] = "the arm is in fault (EKI-010), emergency stop: pressed"


@pytest.mark.hazard(36)
@pytest.mark.parametrize("typed", [b"yes\n", b""])
def test_an_arm_that_stops_at_a_question_is_shown_at_once_and_what_was_typed_before_does_not_count(
    keyboard: int, typed: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    faults: dict[str, str] = {}
    alarms = Alarms()
    alarms.attach(cast(Engine, SimpleNamespace(faults=SimpleNamespace(summaries=faults))))
    monkeypatch.setattr("sys.stderr", screen := ReadScreen(keyboard, faults, typed, b"no\n"))
    question = Question(Topic.REGISTRATION, "accept the registration", VALUE, timeout_s=5.0)
    assert TerminalOperator(alarms=alarms).ask(question).word == "no"
    shown = screen.getvalue().partition("Type yes or no: ")[2]
    assert shown.startswith(
        "\nthe arm is in fault (EKI-010), emergency stop: pressed. Whatever you answer, no mo"
    )
    assert shown.endswith("\nType yes or no (the arm is in fault): ")
    assert shown.count("emergency stop") == 1


class StopsAtThirdLook:
    """Faults of an arm that stops once the start of an answer was handed over."""

    looks = 0

    @property
    def summaries(self) -> dict[str, str]:
        self.looks += 1
        return {} if self.looks < 3 else {"arm": "the arm is in fault (EKI-010)"}


@pytest.mark.hazard(36)
@pytest.mark.parametrize("rest", [b"\n", b"\x04"])
def test_an_answer_whose_end_is_typed_after_the_arm_has_stopped_does_not_count(
    keyboard: int, rest: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    alarms = Alarms()
    alarms.attach(cast(Engine, SimpleNamespace(faults=StopsAtThirdLook())))
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, b"yes\x04", rest, b"no\n"))
    question = Question(Topic.REGISTRATION, "accept the registration", VALUE, timeout_s=5.0)
    assert TerminalOperator(alarms=alarms).ask(question).word == "no"
    assert "the arm is in fault (EKI-010)" in screen.getvalue()


@pytest.mark.hazard(36)
@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_an_arm_that_stops_in_a_pause_is_shown_at_once_and_a_resume_typed_before_does_not_count(
    keyboard: int, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    said: list[str] = []
    faults = {"arm": "the arm is in fault (EKI-010), emergency stop: pressed"} if when == "before" else {}
    typed = iter((b"abort\n",) if when == "before" else (b"resume\n", b"abort\n"))

    def at_prompt(_words: str, *, question: str = "") -> None:
        os.write(keyboard, next(typed))
        faults["arm"] = "the arm is in fault (EKI-010), emergency stop: pressed"

    monkeypatch.setattr("sys.stderr", io.StringIO())
    prompt = Prompt("step> ", said.append, asking=lambda: nullcontext(at_prompt))
    prompt.attach(cast(Engine, SimpleNamespace(faults=SimpleNamespace(summaries=faults))))
    assert prompt.ask(Question(Topic.PAUSE, "paused", VALUE, timeout_s=None)).word == ABORT
    assert [line for line in said if "emergency stop: pressed. No motion and no step begins" in line]


def test_lines_that_were_pasted_are_the_readings_in_turn_until_one_is_refused(
    keyboard: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    dials = Task(DIALS, "read the dials", reads=("x in mm", "y in mm"), plausible_mm=(-10.0, 10.0))
    at_x_y_and_back = (b"0.1\n0.2\nyes\n", b"", b"again\n")  # the yes was pasted before it was asked for
    once_more = (b"11\n0.3\n", b"0.4\n0.5\n", b"", b"yes\n")
    monkeypatch.setattr("sys.stderr", Screen(keyboard, *at_x_y_and_back, *once_more))
    assert TerminalRoom().work(dials) == (0.4, 0.5)


@pytest.mark.hazard(9)
def test_a_wrong_patient_identifier_confirms_nothing_and_the_right_one_is_not_revealed(
    keyboard: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    wristband = ReadBack("the patient's identifier", "Case-17", exact=True)
    monkeypatch.setattr("sys.stderr", screen := Screen(keyboard, b"yes\n", b"case-18\n", b"no\n"))
    assert ask(read_back=wristband) == "no"
    assert "17" not in screen.getvalue()
    assert "17" not in repr(wristband)
    monkeypatch.setattr("sys.stderr", Screen(keyboard, b"yes\n", b" Case-17 \n"))
    assert ask(read_back=wristband) == "yes"


@pytest.mark.hazard(9)
@pytest.mark.parametrize("typed", ["case-0017", "Case-17", "Case- 0017", "Case-0017 x", "Case0017"])
def test_an_identifier_that_differs_in_case_spaces_or_zeros_is_another_patients(typed: str) -> None:
    wristband = ReadBack("the patient's identifier", "Case-0017", exact=True)
    assert not wristband.fits(typed)
    assert wristband.fits("Case-0017\n")
