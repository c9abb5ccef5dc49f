"""Readings of the room's manual work, typed at the console."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell
from session_orders import SessionOrders
from waiting import eventually

from procedures.engine.engine import Engine
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.question import Task
from procedures.runs.operator_station import OperatorStation
from procedures.runs.order_executor import ConsoleRoom, OrderExecutor
from procedures.runs.orders import read_order

GAUGE = Task("gauge", "read the gauge", reads=("gap in mm", "turn in mm"))


class Terminal:
    """Whoever would do it without the console."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def announce(self, step: str) -> None:
        self.asked.append(step)

    def change_tool(self, number: int, description: str) -> None:
        self.asked.append(description)

    def prepare_stand(self, holds: str) -> None:
        self.asked.append(holds)

    def work(self, task: Task) -> tuple[float, ...]:
        self.asked.append(task.subject)
        return (9.0,) * len(task.reads)


class Stand:
    """A case that is operated from the console by Ana, and its room."""

    def __init__(self, folder: Path, *, waits: bool = True) -> None:
        self.station = OperatorStation(waits=waits)
        self.terminal = Terminal()
        executor = OrderExecutor(self.station, runs=True)
        self.room = ConsoleRoom(self.terminal, executor)
        cell = RecordingCell(folder)
        cell.operator = executor.operator(cell.operator)  # type: ignore[assignment]  # the cell's own is a recorder
        self.engine: Engine = cell.engine(plain_order())
        executor.attach(self.engine)
        self.give = SessionOrders(self.station)
        self.give("claim", name="Ana")

    def answer(self, answer: str, readings: list[float] | None = None) -> str:
        eventually(lambda: self.station.open_question is not None)
        assert self.station.open_question is not None
        number, shown = self.station.open_question
        return self.give("answer", question=number, answer=answer, shown=shown, readings=readings)

    def work(self, task: Task) -> list[tuple[float, ...]]:
        """Have it done on a thread of its own; what was read stands in the list when it is."""
        read: list[tuple[float, ...]] = []
        threading.Thread(target=lambda: read.append(self.room.work(task)), daemon=True).start()
        return read


@pytest.fixture
def stand(tmp_path: Path) -> Stand:
    return Stand(tmp_path)


def test_a_task_is_told_at_the_terminal_its_reading_typed_at_the_console_and_signed(stand: Stand) -> None:
    read = stand.work(GAUGE)
    assert stand.answer("read", [0.03, -0.01]) == ""
    eventually(lambda: read == [(0.03, -0.01)])
    lines = read_journal(stand.engine.case.folder / JOURNAL_FILE)
    confirmed = [line for line in lines if line["entry"] == "confirmation"]
    assert [(line["topic"], line["by"]) for line in confirmed] == [("reading", "Ana")]
    assert stand.terminal.asked == ["read the gauge"]


@pytest.mark.parametrize("readings", [None, [], [0.03], [0.03, 0.01, 0.02]])
def test_a_wrong_number_of_readings_is_refused(stand: Stand, readings: list[float] | None) -> None:
    read = stand.work(GAUGE)
    assert stand.answer("read", readings) == "type gap in mm, turn in mm"
    assert read == []
    stand.station.leave()


@pytest.mark.parametrize("reading", ["NaN", "Infinity", "1e999", '"0.1"', "true"])
def test_a_reading_that_is_not_a_finite_number_is_refused(reading: str) -> None:
    order = (
        '{"kind":"answer","session":"session-ana","nonce":"nonce-001","question":1,"answer":"read",'
        f'"shown":"{"0" * 64}","readings":[{reading}]}}'
    )
    with pytest.raises(ValueError, match=r"readings|number|bounds"):
        read_order(order)


def test_the_answer_nobody_ends_the_step(stand: Stand) -> None:
    read = stand.work(GAUGE)
    assert stand.answer("nobody") == ""
    eventually(lambda: read == [()])


def test_the_terminal_is_asked_when_the_console_ends_meanwhile(stand: Stand) -> None:
    read = stand.work(GAUGE)
    eventually(lambda: stand.station.open_question is not None)
    stand.station.leave()
    eventually(lambda: read == [(9.0, 9.0)])
    assert stand.terminal.asked == ["read the gauge", "read the gauge"]


def test_a_task_without_readings_is_shown_at_the_terminal(stand: Stand) -> None:
    assert stand.room.work(Task("out", "take it out")) == ()
    assert stand.terminal.asked == ["take it out"]
