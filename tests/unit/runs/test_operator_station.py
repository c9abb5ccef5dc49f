"""Orders from the console, as the engine's side receives them."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell
from session_orders import ANA, SessionOrders
from waiting import eventually

from procedures.cli.case.commands import carry_out
from procedures.engine.events import Seat
from procedures.engine.events.event_types import digest_of_question
from procedures.engine.questions import as_shown
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.question import Answer, Question, ReadBack, Signature, Topic
from procedures.runs.answers import ScriptedOperator
from procedures.runs.operator_station import LEASE_S, OperatorStation, PendingOrder
from procedures.runs.order_executor import OrderExecutor
from procedures.runs.orders import Resume, read_order

BEN = "session-ben"


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Stand:
    """A station with an engine, and orders with nonces of their own."""

    def __init__(self, folder: Path, *, waits: bool = False) -> None:
        self.clock = Clock()
        self.station = OperatorStation(waits=waits, now_s=self.clock)
        self.engine = RecordingCell(folder).engine(plain_order())
        self.station.attach(self.engine)
        self.answered: list[Answer | None] = []  # with signatures and readings
        self.give = SessionOrders(self.station)

    @property
    def signatures(self) -> list[Signature | None]:
        return [answer and answer.signature for answer in self.answered]

    def ask(self, question: Question) -> list[str | None]:
        """Ask on a thread of its own; what came of it stands in the list when it is answered."""
        answers: list[str | None] = []

        def ask() -> None:
            answer = self.station.ask(question)
            self.answered.append(answer)
            answers.append(answer and answer.word)

        threading.Thread(target=ask, daemon=True).start()
        eventually(lambda: self.station.open_question is not None)
        return answers

    def await_order(self, upcoming: str = "image") -> list[PendingOrder | None]:
        """As `ask`, for what is wished between steps."""
        pending: list[PendingOrder | None] = []
        threading.Thread(
            target=lambda: pending.append(self.station.next_order(upcoming)), daemon=True
        ).start()
        eventually(lambda: self.station.waiting_for == upcoming)
        return pending


@pytest.fixture
def stand(tmp_path: Path) -> Stand:
    stand = Stand(tmp_path)
    assert stand.give("claim", name="Ana") == ""
    return stand


def question(**more: Any) -> Question:
    return Question(Topic.PARK, "park the arm", "moves 12 mm", number=1, timeout_s=60.0, **more)


def shown(asked: Question) -> str:
    return digest_of_question(as_shown(asked, asked.number))


def test_the_desk_is_in_charge_before_the_seat_is_taken_only_if_the_case_waits_for_it(tmp_path: Path) -> None:
    assert not Stand(tmp_path).station.in_charge
    assert Stand(tmp_path / "other", waits=True).station.in_charge


def test_an_answer_counts_only_with_the_digest_of_the_question_and_is_signed(stand: Stand) -> None:
    asked = question()
    answers = stand.ask(asked)
    wrong = {"question": 1, "answer": "yes", "shown": "0" * 64}
    assert stand.give("answer", **wrong) == "the question shown is not the question asked"
    assert stand.give("answer", question=2, answer="yes", shown=shown(asked)) != ""
    assert stand.give("answer", question=1, answer="perhaps", shown=shown(asked)) != ""
    assert answers == []
    assert stand.give("answer", question=1, answer="yes", shown=shown(asked)) == ""
    eventually(lambda: answers == ["yes"])
    assert stand.signatures == [Signature("Ana", ANA, shown(asked))]


def test_an_affirmative_answer_needs_the_correct_read_back(stand: Stand) -> None:
    misread: list[None] = []
    asked = question(read_back=ReadBack("how many mm", "12"), misread=lambda: misread.append(None))
    answers = stand.ask(asked)
    given = {"question": 1, "answer": "yes", "shown": shown(asked)}
    assert stand.give("answer", **given) == "type how many mm"
    assert stand.give("answer", **given, typed="13") == "'13' is not the value to be read back; 2 tries left"
    assert stand.give("answer", **given, typed="Help") == "type how many mm"
    eventually(lambda: len(misread) == 1)
    assert stand.give("answer", **given, typed=" 12 ") == ""
    eventually(lambda: answers == ["yes"])


def test_three_wrong_values_read_back_count_as_no(stand: Stand) -> None:
    misread: list[None] = []
    asked = question(read_back=ReadBack("how many mm", "12"), misread=lambda: misread.append(None))
    answers = stand.ask(asked)
    given = {"question": 1, "answer": "yes", "shown": shown(asked)}
    said = [stand.give("answer", **given, typed=typed).partition("; ")[2] for typed in ("13", "1", "2")]
    assert said == ["2 tries left", "1 try left", "3 wrong values count as 'no'"]
    eventually(lambda: answers == ["no"])
    assert len(misread) == 3
    assert stand.give("answer", **given, typed="12") == "that question is no longer open"


def test_the_unit_may_be_typed_with_the_read_back() -> None:
    read_back = ReadBack("how many mm it moves first", "169", unit="mm")
    fits = [read_back.fits(typed) for typed in ("169", "169mm", " 169 MM ", "169 cm", "mm")]
    assert fits == [True, True, True, False, False]


def test_an_implausible_reading_is_refused(stand: Stand) -> None:
    asked = question(reads=("x in mm",), plausible_mm=(-10.0, 10.0))
    answers = stand.ask(asked)
    given = {"question": 1, "answer": "yes", "shown": shown(asked)}
    assert stand.give("answer", **given, readings=[100.0]) == "100 is implausible: expected -10 to 10"
    assert stand.give("answer", **given, readings=[0.1]) == ""
    eventually(lambda: answers == ["yes"])
    assert [answer and answer.readings for answer in stand.answered] == [(0.1,)]


def test_a_late_order_is_refused_but_a_late_stop_is_not(stand: Stand) -> None:
    late = {"expires_s": stand.clock.now_s - 0.1}
    stand.await_order()
    assert stand.give("next", upcoming="image", **late) == "the order came too late"
    assert stand.give("stop", **late) == ""


def test_no_answer_in_time_gives_the_last_answer(stand: Stand) -> None:
    answers = stand.ask(question())
    stand.clock.now_s += 61.0
    eventually(lambda: answers == ["no"])


def test_a_console_that_ends_leaves_its_question_unanswered(stand: Stand) -> None:
    answers, pending = stand.ask(question()), stand.await_order()
    stand.station.leave()
    eventually(lambda: (answers, pending) == ([None], [None]))
    assert not stand.station.in_charge


def test_a_seat_is_kept_by_renewing_and_freed_when_its_page_is_silent(stand: Stand) -> None:
    for _ in range(3):
        stand.clock.now_s += LEASE_S - 1.0
        stand.give("renew")
    assert stand.give("claim", BEN, name="Ben") == "the seat is taken by Ana"
    stand.clock.now_s += LEASE_S + 1.0
    assert not stand.station.is_occupied_since(0)
    assert stand.give("renew") == ""
    assert stand.give("pause") == "you are not in the operator's seat"
    assert stand.give("claim", BEN, name="Ben") == ""
    changes = stand.station.changes_of_seat()
    assert [(session, name) for session, name, _since_s in changes] == [(ANA, "Ana"), ("", ""), (BEN, "Ben")]


def test_a_question_expires_unsigned_while_its_operators_page_is_suspended_and_waking_does_not_reopen_it(
    stand: Stand,
) -> None:
    asked = question()
    answers, given = stand.ask(asked), {"question": 1, "answer": "yes", "shown": shown(asked)}
    stand.clock.now_s += LEASE_S + 1.0
    assert stand.give("answer", **given) == "you are not in the operator's seat"
    assert answers == []
    stand.clock.now_s += 60.0 - LEASE_S
    eventually(lambda: answers == ["no"])
    assert stand.give("claim", name="Ana") == ""
    assert stand.give("answer", **given) == "that question is no longer open"
    assert stand.signatures == [None]


def test_of_two_simultaneous_claims_exactly_one_is_refused(tmp_path: Path) -> None:
    stand = Stand(tmp_path)
    said: list[str] = []
    both = [
        threading.Thread(target=lambda one=one: said.append(stand.give("claim", one, name=one)))
        for one in (ANA, BEN)
    ]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    assert sorted(bool(one) for one in said) == [False, True]


def test_a_pause_ends_only_by_its_question_and_resume_works_between_steps(stand: Stand) -> None:
    pause = Question(Topic.PAUSE, "Paused", "here", ("continue", "abort"), number=3, timeout_s=None)
    answers = stand.ask(pause)
    assert stand.give("next", upcoming="image") != ""
    assert stand.give("resume", upcoming="image").startswith("the engine is not waiting for an order")
    assert answers == []
    assert stand.give("answer", question=3, answer="continue", shown=shown(pause)) == ""
    eventually(lambda: answers == ["continue"])
    pending = stand.await_order()
    assert stand.give("resume", upcoming="fit:T1") == "out of date: the next step is now image"
    assert stand.give("resume", upcoming="image") == ""
    eventually(lambda: [(one and type(one.order), one and one.by) for one in pending] == [(Resume, "Ana")])


def test_an_abort_takes_effect_at_the_next_checkpoint_and_declines_the_question_without_signing_it(
    stand: Stand,
) -> None:
    answers = stand.ask(question())
    assert stand.give("abort") == ""
    eventually(lambda: answers == ["no"])
    assert stand.engine.checkpoint.wanted
    assert stand.station.aborting
    pause = Question(Topic.PAUSE, "Paused", "here", ("continue", "abort"))
    answers = stand.ask(pause)
    stand.give("abort")
    eventually(lambda: answers == ["abort"])
    assert stand.signatures == [None, Signature("Ana", ANA, shown="")]  # its page may not have shown it


def test_an_abort_right_after_a_pause_was_answered_still_ends_the_case(stand: Stand) -> None:
    pause = Question(Topic.PAUSE, "Paused", "here", ("continue", "abort"), number=3, timeout_s=None)
    entered, done = threading.Event(), threading.Event()

    def acknowledge(_by: str) -> None:  # keeps the engine's thread from fetching the answer
        entered.set()
        assert done.wait(10.0)

    asking = threading.Thread(target=stand.station.ask, args=(pause, acknowledge), daemon=True)
    asking.start()
    eventually(lambda: stand.station.open_question is not None)
    assert stand.give("acknowledge") == ""
    assert entered.wait(10.0)
    assert stand.give("answer", question=3, answer="continue", shown=shown(pause)) == ""
    assert stand.give("abort") == ""
    done.set()
    asking.join(10.0)
    assert stand.engine.checkpoint.wanted
    assert stand.station.aborting


@pytest.mark.parametrize(
    ("session", "who"), [(ANA, "Ana"), (BEN, f"someone outside the operator's seat (session {BEN})")]
)
def test_a_stop_is_recorded_under_the_name_of_the_seat_only_if_it_came_from_there(
    stand: Stand, session: str, who: str
) -> None:
    assert stand.give("stop", session) == ""
    stand.engine.checkpoint.here("here")
    lines = read_journal(stand.engine.case.folder / JOURNAL_FILE)
    assert [line["reason"] for line in lines if line["entry"] == "rested"] == [f"{who} stopped the arm"]


@pytest.mark.hazard(32)
def test_a_script_does_not_continue_a_case_that_a_person_stopped(tmp_path: Path) -> None:
    stand = Stand(tmp_path)  # nobody is in the seat
    operator = OrderExecutor(stand.station, runs=True).operator(ScriptedOperator(), script_at_pause=True)
    pause = Question(Topic.PAUSE, "Paused", "here", ("continue", "abort"), number=1)
    assert operator.ask(pause).word == "continue"
    stand.give("stop", BEN)
    answers: list[str] = []
    threading.Thread(target=lambda: answers.append(operator.ask(pause).word), daemon=True).start()
    eventually(lambda: stand.station.open_question is not None)
    given = {"question": 1, "answer": "continue", "shown": shown(pause)}
    assert stand.give("answer", BEN, **given) == "you are not in the operator's seat"
    stand.give("claim", name="Ana")
    assert answers == []
    assert stand.give("answer", **given) == ""
    eventually(lambda: answers == ["continue"])
    assert not stand.station.stopped


@pytest.mark.hazard(32)
def test_a_console_that_ends_before_its_stop_is_met_leaves_no_script_to_continue(tmp_path: Path) -> None:
    stand = Stand(tmp_path)
    operator = OrderExecutor(stand.station, runs=True).operator(ScriptedOperator(), script_at_pause=True)
    stand.give("stop", BEN)
    stand.station.leave()
    assert operator.ask(Question(Topic.PAUSE, "Paused", "here", ("continue", "abort"))).word == "abort"


@pytest.mark.hazard(32)
def test_a_stop_between_steps_is_not_withdrawn_by_a_line_of_a_script(stand: Stand) -> None:
    stand.give("stop", BEN)
    said: list[str] = []
    carry_out(stand.engine, Resume(), said.append)
    assert said[0].startswith("the arm was stopped: that is asked about when the next step begins")
    assert stand.engine.checkpoint.wanted


@pytest.mark.hazard(32)
def test_a_stopped_case_ends_with_its_console_and_is_not_continued_by_a_script(tmp_path: Path) -> None:
    stand = Stand(tmp_path)
    operator = OrderExecutor(stand.station, runs=True).operator(ScriptedOperator(), script_at_pause=True)
    stand.give("stop", BEN)
    answers: list[str] = []
    pause = Question(Topic.PAUSE, "Paused", "here", ("continue", "abort"), number=1)
    threading.Thread(target=lambda: answers.append(operator.ask(pause).word), daemon=True).start()
    eventually(lambda: stand.station.open_question is not None)
    stand.station.leave()
    eventually(lambda: answers == ["abort"])


def test_the_journal_says_since_when_the_seat_is_taken_however_late_it_is_written(stand: Stand) -> None:
    reader = stand.engine.events.subscribe()
    stand.give("release")
    (event,) = [one for one in reader.read(0.0).events if isinstance(one.what, Seat) and not one.what.holder]
    for change in stand.station.changes_of_seat():
        stand.engine.record_seat(*change)
    lines = read_journal(stand.engine.case.folder / JOURNAL_FILE)
    (freed,) = [line for line in lines if line["entry"] == "seat" and not line["by"]]
    assert freed["since_s"] == event.theatre_time_s


@pytest.mark.parametrize("name", ["", " ", "a" * 61, "a\nb"])
def test_a_name_must_be_one_readable_line(name: str) -> None:
    with pytest.raises(ValueError, match="name"):
        read_order(json.dumps({"kind": "claim", "session": ANA, "nonce": "nonce-1x", "name": name}))
