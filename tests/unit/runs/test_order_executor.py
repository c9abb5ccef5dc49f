"""A case run by orders from the console, on the engine's own thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from coded_errors import raises
from plain_steps import Fit, Image, only_home_remains, plain_order
from recording_cell import HOME, RecordingCell
from session_orders import SessionOrders
from waiting import eventually

from procedures.cli.case.prompt import Prompt
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.errors import CONSOLE_MISSING
from procedures.engine.order import Outcome
from procedures.engine.questions import Questions
from procedures.journal.errors import GateFailed
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.journal.results import StepResult
from procedures.operator.errors import OperatorAborted
from procedures.operator.question import Topic
from procedures.runs.console_link import check_console
from procedures.runs.lifecycle import run_to_end
from procedures.runs.observers import RunObservers
from procedures.runs.operator_station import OperatorStation
from procedures.runs.order_executor import OrderExecutor
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import RonnaError


class Operated:
    """A case with a executor, run on a thread of its own, and Ana's orders."""

    def __init__(self, engine: Engine, *, waits: bool = True, runs: bool = True) -> None:
        self.engine = engine
        self.executor = OrderExecutor(OperatorStation(waits=waits), runs=runs)
        self.executor.attach(engine)
        self.ended_by: list[BaseException | None] = []
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.give = SessionOrders(self.executor.station)

    def _run(self) -> None:
        try:
            self.executor.run_to_end(self.engine)
            self.ended_by.append(None)
        except BaseException as problem:
            self.ended_by.append(problem)

    def await_waiting(self) -> None:
        eventually(lambda: self.executor.station.waiting_for is not None)

    def stands(self, name: str) -> bool:
        return self.engine.case.stands(self.engine.order.find(name))


@contextmanager
def running(operated: Operated, *, claimed: bool = True) -> Iterator[Operated]:
    """Run the case, with Ana in the operator's seat unless it is not `claimed`."""
    operated.thread.start()
    if claimed:
        operated.await_waiting()
        operated.give("claim", name="Ana")
    yield operated
    operated.executor.station.leave()
    operated.thread.join(20)


def test_a_waiting_case_does_nothing_until_the_operators_seat_is_taken(cell: RecordingCell) -> None:

    with running(Operated(cell.engine(plain_order()), runs=False), claimed=False) as case:
        case.await_waiting()
        assert case.give("next", upcoming="image") == "you are not in the operator's seat"
        assert case.give("claim", name="Ana") == ""
        assert case.give("next", upcoming="image") == ""
        eventually(lambda: case.stands("image"))
        case.await_waiting()
        assert not case.stands("localization:T1")
    entries = [
        line for line in read_journal(case.engine.case.folder / JOURNAL_FILE) if line["entry"] == "seat"
    ]
    assert entries[0]["by"] == "Ana"


def test_run_to_stops_after_its_step_and_resume_runs_to_the_end(cell: RecordingCell) -> None:
    with running(Operated(cell.engine(plain_order()))) as case:
        assert case.give("run_to", upcoming="image", step="fit:T1") == ""
        eventually(lambda: case.stands("fit:T1"))
        case.await_waiting()
        assert case.engine.upcoming != case.engine.order.find("fit:T1")
        assert case.give("resume", upcoming=str(case.engine.upcoming)) == ""
        eventually(lambda: case.ended_by == [None])
        assert case.engine.machine.state == "finished"


def test_run_to_stops_where_its_step_is_left_out(cell: RecordingCell) -> None:
    def leaves_out(context: StepContext) -> Outcome[StepResult]:
        return Outcome(Fit(not_for=("T2",) if context.trajectory == "T2" else ()))

    with running(Operated(cell.engine(plain_order("T1", "T2", "T3", fit=leaves_out)))) as case:
        assert case.give("run_to", upcoming="image", step="approach:T2") == ""
        eventually(lambda: case.stands("fit:T2"))
        case.await_waiting()
        assert case.executor.station.waiting_for == "localization:T3"


def test_a_simulated_case_runs_without_an_operator_in_the_seat(cell: RecordingCell) -> None:
    case = Operated(cell.engine(plain_order()), waits=False)
    case.executor.run_to_end(case.engine)
    assert case.engine.machine.state == "finished"


class Dying(OperatorStation):
    """A station whose console ends right before it is looked at."""

    def __init__(self, before: str) -> None:
        super().__init__(waits=True)
        self._before = before

    @property
    def in_charge(self) -> bool:
        self._end_before("in_charge")
        return super().in_charge

    @property
    def gone(self) -> bool:
        self._end_before("gone")
        return super().gone

    def _end_before(self, looked_at: str) -> None:
        if looked_at == self._before:
            self.leave()


@pytest.mark.parametrize("before", ["", "in_charge", "gone"])
def test_a_case_does_nothing_once_its_console_ends_until_the_operator_continues_without_it(
    cell: RecordingCell, before: str
) -> None:
    cell.operator.refusing = (Topic.PAUSE,)
    case = Operated(cell.engine(plain_order()))
    case.executor.station = Dying(before)
    case.executor.attach(case.engine)
    if not before:
        case.executor.station.leave()
    case._run()
    assert isinstance(case.ended_by[0], OperatorAborted)
    assert [question.topic for question in cell.operator.asked] == [Topic.PAUSE]
    assert not case.stands("image")


def test_a_case_continued_without_its_console_runs_to_its_end(cell: RecordingCell) -> None:
    case = Operated(cell.engine(plain_order()))
    case.executor.station.leave()
    case._run()
    assert case.engine.machine.state == "finished"


def test_orders_of_an_operator_who_left_the_seat_are_not_carried_out_for_the_next(
    cell: RecordingCell,
) -> None:
    def leaving(context: StepContext) -> Outcome[StepResult]:
        case.give("release")
        case.give("claim", name="Ben")
        return Outcome(Image())

    case = Operated(cell.engine(plain_order(image=leaving)))
    with running(case):
        case.give("resume", upcoming="image")
        eventually(lambda: case.stands("image"))
        case.await_waiting()
        assert not case.stands("localization:T1")
        assert case.give("run_to", upcoming="localization:T1", step="image") == "image is already done"


def failing(times: int) -> Callable[[StepContext], Outcome[StepResult]]:
    left = [times]

    def work(context: StepContext) -> Outcome[StepResult]:
        left[0] -= 1
        if left[0] >= 0:
            raise GateFailed("too far")
        return Outcome(Image())

    return work


def test_a_failed_step_holds_the_case_until_the_operator_repeats_it(
    cell: RecordingCell, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(Operated(cell.engine(plain_order(image=failing(1))))) as case:
        case.give("next", upcoming="image")
        eventually(lambda: case.engine.machine.state == "held")
        case.await_waiting()
        case.give("next", upcoming="image")
        eventually(lambda: case.stands("image"))
    assert "PRO-007" in capsys.readouterr().err


def test_an_abort_between_steps_ends_the_case(cell: RecordingCell) -> None:
    with running(Operated(cell.engine(plain_order()))) as case:
        assert case.give("abort") == ""
        eventually(lambda: len(case.ended_by) == 1)
    assert isinstance(case.ended_by[0], OperatorAborted)
    assert case.engine.machine.state == "aborted"


def away(cell: RecordingCell) -> None:
    """Lead the arm away from home."""
    cell.workcell.master.set_home()
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 0.5, *others)  # type: ignore[assignment]  # six again


def test_an_abort_at_the_console_asks_for_the_way_home_once_also_at_a_terminal(cell: RecordingCell) -> None:
    case = Operated(cell.engine(plain_order()))
    away(cell)
    case.give("claim", name="Ana")
    case.give("abort")
    with pytest.raises(OperatorAborted):
        run_to_end(case.engine, RunObservers(held=Prompt("", print), executor=case.executor))
    assert [question.topic for question in cell.operator.asked].count(Topic.PARK) == 1
    assert cell.entries("home") == [("home", "")]


def aborted_on_its_way_home(case: Operated, cell: RecordingCell) -> None:
    """The operator pauses the way home, and ends the case there."""
    case.engine.checkpoint.pause()
    cell.operator.refusing = (Topic.PAUSE,)
    try:
        case.engine.retreat_home()
    finally:
        cell.operator.refusing = ()


@pytest.mark.hazard(50)
@pytest.mark.branch("ABORTED")
def test_an_abort_on_the_agreed_way_home_is_led_home_where_only_a_console_is_attached(
    cell: RecordingCell,
) -> None:
    def fails(_context: StepContext) -> Outcome[StepResult]:
        raise GateFailed("the cart has moved")

    def agreed(_problem: RonnaError) -> bool:
        aborted_on_its_way_home(case, cell)
        return True

    case = Operated(cell.engine(plain_order(image=fails)))
    away(cell)
    case.engine.goes_on = agreed
    with running(case):
        case.give("next", upcoming="image")
        eventually(lambda: len(case.ended_by) == 1)
    assert isinstance(case.ended_by[0], OperatorAborted)
    assert case.engine.machine.state == "aborted"
    assert cell.workcell.master.place.is_home


@pytest.mark.branch("ABORTED")
def test_an_abort_on_the_way_home_of_an_abort_at_the_console_ends_the_case(cell: RecordingCell) -> None:
    cell.operator.refusing = (Topic.PAUSE,)
    cell.operator.meanwhile = lambda question: (
        case.engine.checkpoint.pause() if question.topic is Topic.PARK else None
    )
    case = Operated(cell.engine(plain_order()))
    away(cell)
    with running(case):
        case.give("abort")
        eventually(lambda: len(case.ended_by) == 1)
    assert isinstance(case.ended_by[0], OperatorAborted)
    assert (case.engine.machine.state, cell.arm.motions) == ("aborted", [])
    assert cell.entries("interrupted") == [("interrupted", "")]


class NeverRestored:
    """A guard that asks at once, and stays unmet."""

    name = "line of sight"
    topic, patience_s, excused_for_s = Topic.HEAD_UNSEEN, 0.0, 10.0

    def unmet(self) -> str:
        return "covered"

    def excuse(self) -> None:
        """Nobody asks to do without it."""


def test_an_abort_ends_a_case_whose_guard_is_not_restored_before_it_nor_on_the_way_home(
    cell: RecordingCell,
) -> None:
    cell.operator.refusing = (Topic.HEAD_UNSEEN,)
    case = Operated(cell.engine(plain_order()))
    away(cell)
    case.engine.checkpoint.guards.append(NeverRestored())
    with running(case):
        case.give("abort")
        eventually(lambda: len(case.ended_by) == 1)
    assert isinstance(case.ended_by[0], OperatorAborted)
    assert [question.topic for question in cell.operator.asked].count(Topic.HEAD_UNSEEN) == 2
    assert (case.engine.machine.state, cell.arm.motions) == ("aborted", [])


def test_the_operator_at_the_console_acknowledges_and_brings_home_when_every_step_is_done(
    cell: RecordingCell,
) -> None:
    case = Operated(cell.engine(only_home_remains()), runs=False)
    case.engine.run_to()
    cell.arm.state = Lifecycle.FAULT
    with running(case):
        assert case.give("next", upcoming="home") == ""
        eventually(lambda: case.give("acknowledge") == "")  # the arm in fault holds the case
        eventually(lambda: "recovered by Ana" in cell.arm.calls)
        eventually(lambda: case.give("next", upcoming="home") == "")
        eventually(lambda: case.ended_by == [None])
    assert (cell.arm.joints_rad, case.engine.machine.state) == (HOME, "finished")


@pytest.mark.hazard(32)
def test_a_fault_acknowledged_at_the_console_in_a_pause_has_its_step_begun_again(cell: RecordingCell) -> None:
    case = Operated(cell.engine(plain_order()), runs=False)
    cell.operator = case.executor.operator(cell.operator)  # type: ignore[assignment]
    case.engine.questions = Questions(cell.setting(), cell.journal, case.engine.events)
    with running(case):
        case.engine.checkpoint.pause()
        assert case.give("next", upcoming="image") == ""
        eventually(lambda: case.executor.station.open_question is not None)
        cell.arm.state = Lifecycle.FAULT
        assert case.give("acknowledge") == ""
        eventually(lambda: "recovered by Ana" in cell.arm.calls)
        assert case.executor.station.open_question is not None
        number, shown = case.executor.station.open_question
        answer = {"question": number, "answer": "continue", "shown": shown}
        assert case.give("answer", **answer) == ""
        case.await_waiting()
        assert cell.entries("failed") == [("failed", "image")]  # PRO-001: it is begun again
        assert case.give("next", upcoming="image") == ""
        eventually(lambda: case.stands("image"))


def test_a_missing_console_package_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with raises(CONSOLE_MISSING, match="PRO-040"):
        check_console()
