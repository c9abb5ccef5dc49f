"""What a person sees of a running case."""

from __future__ import annotations

import io
import sys
from contextlib import suppress
from functools import reduce
from pathlib import Path

import pytest
from plain_steps import Image, leaves, plain_order
from recording_cell import RecordingCell
from rich.console import Console

from procedures.cli.case.case_lines import (
    describe_activity,
    entry_of,
    join_voided,
    plain_line_of,
    status_lines,
)
from procedures.cli.case.display import observe_run
from procedures.cli.case.live_display import LiveDisplay
from procedures.cli.runs.showing import line_of
from procedures.engine.case_view import CaseView, fold
from procedures.engine.context import StepContext
from procedures.engine.events import Event, EventStream, Fault, JournalLine, Refusal, Seat, StepState, Waiting
from procedures.engine.order import Outcome
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult
from procedures.runs.observers import SEAT_AWAITED
from ronna_hw.command_line.messages import fail_with

REASON = "the controller is silent"
CURSOR_UP = "\x1b[1A"


@pytest.fixture
def events(tmp_path: Path) -> list[Event]:
    """Of a case whose first step has failed."""

    def fails(_context: StepContext) -> Outcome[StepResult]:
        raise GateFailed(REASON)

    engine = RecordingCell(tmp_path).engine(plain_order("T1", image=fails))
    reader = engine.events.subscribe()
    with pytest.raises(GateFailed):
        engine.run_to()
    return list(reader.read(0.0).events)


def test_the_live_view_shows_once_why_a_case_is_held(events: list[Event]) -> None:
    text = "\n".join(line for _, line in status_lines(reduce(fold, events, CaseView())))
    assert text.startswith("held\n")
    assert text.count(REASON) == 1


def test_the_error_of_a_step_disappears_when_the_step_is_repeated_successfully(tmp_path: Path) -> None:
    tries = iter([GateFailed(REASON), None])

    def fails_once(context: StepContext) -> Outcome[StepResult]:
        if (problem := next(tries)) is not None:
            raise problem
        return leaves(Image)(context)

    engine = RecordingCell(tmp_path).engine(plain_order("T1", image=fails_once))
    reader, view = engine.events.subscribe(), CaseView()
    shown = []
    for _ in range(2):
        with suppress(GateFailed):
            engine.run_step(engine.order.find("image"))
        view = reduce(fold, reader.read(0.0).events, view)
        shown.append(REASON in "\n".join(line for _, line in status_lines(view)))
    assert shown == [True, False]


def test_what_was_refused_because_of_a_fault_disappears_when_the_fault_is_acknowledged() -> None:
    view, events = CaseView(), EventStream(lambda: 0.0)
    reader = events.subscribe()
    stopped = "EKI-010: robot.master was stopped: emergency stop is active. Release it."
    events.publish(Fault(code="EKI-010", what=stopped))
    events.publish(Refusal(step="tool_change", unmet=("the arm is in fault (EKI-010), pressed",)))
    view = reduce(fold, reader.read(0.0).events, view)
    assert sum(style == "red" for style, _text in status_lines(view)) == 2
    said = {"entry": "acknowledged", "device": "arm", "fault": "EKI-010: stopped", "by": "Ann"}
    events.publish(JournalLine(line=said))
    view = reduce(fold, reader.read(0.0).events, view)
    assert not any(style == "red" for style, _text in status_lines(view))


def test_the_live_view_names_whom_a_case_waits_for_until_its_step_begins() -> None:
    view, events = CaseView(), EventStream(lambda: 0.0)
    reader = events.subscribe()
    shown = []
    for what in (
        Waiting(upcoming="ct_import"),
        Seat(holder="Ann"),
        Seat(holder=""),
        StepState(step="ct_import", state="begun"),
        Seat(holder="Ben"),
    ):
        events.publish(what)
        view = reduce(fold, reader.read(0.0).events, view)
        shown.append(describe_activity(view))
    free = f"{SEAT_AWAITED}; next is ct_import"
    assert shown == [free, "waiting for an order of Ann; next is ct_import", free, "ct_import", "ct_import"]


def test_a_failed_step_shows_only_its_code_where_errors_are_reported_separately(events: list[Event]) -> None:
    said = [entry.text for event in events if (entry := entry_of(event, errors=False)) is not None]
    assert said == [f"Image (image): {GateFailed.code}"]


def test_a_result_that_no_longer_holds_is_told_with_the_reason_and_not_as_repeated(tmp_path: Path) -> None:
    engine = RecordingCell(tmp_path).engine(plain_order("T1"))
    engine.run_to(engine.order.find("localization:T1"))
    reader = engine.events.subscribe()
    engine.void(engine.order.find("localization:T1"), GateFailed("the head has moved"))
    voided = [one for one in reader.read(0.0).events if "superseded" in str(one.what)]
    lines = [(entry.text, plain_line_of(one)) for one in voided if (entry := entry_of(one)) is not None]
    text = "02-localization-T1 no longer holds: the head has moved"
    assert lines == [(text, f"note: {text}")]


def test_results_that_one_reason_voids_are_told_in_one_line(tmp_path: Path) -> None:
    engine = RecordingCell(tmp_path).engine(plain_order("T1"))
    engine.run_to(engine.order.find("localization:T1"))
    reader = engine.events.subscribe()
    engine.void(engine.order.sequence[0], GateFailed("the head has moved"))
    lines = [line for one in join_voided(reader.read(0.0).events) if (line := plain_line_of(one))]
    (line,) = (line for line in lines if line.startswith("note: "))
    assert line.endswith("-localization-T1 no longer hold: the head has moved")
    assert line.startswith("note: 01-")


def test_a_live_view_that_reappears_keeps_text_written_meanwhile() -> None:
    terminal = io.StringIO()
    display = LiveDisplay(Console(file=terminal, force_terminal=True, width=80), errors=False)
    with display.shown():
        with display.hidden():
            terminal.write("acknowledged by A. Nurse\n")
        _, _, after = terminal.getvalue().partition("acknowledged by A. Nurse\n")
    assert CURSOR_UP not in after.partition("starting")[0]


def test_brackets_in_what_a_case_is_doing_are_text() -> None:
    terminal = io.StringIO()
    display = LiveDisplay(Console(file=terminal, force_terminal=True, width=80), errors=False)
    with display.shown():
        display.status("reading [/a] and [red]b")
    assert "reading [/a] and [red]b" in terminal.getvalue()


def test_an_error_during_a_live_view_is_written_above_it(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    above, past = Terminal(), Terminal()
    above.rich_proxied_file = past  # type: ignore[attr-defined]  # as the live picture's own has it
    monkeypatch.setattr(sys, "stderr", above)
    fail_with(GateFailed(REASON), advice="Wait.")
    assert f"{REASON}. Wait." in above.getvalue()
    assert past.getvalue() == ""


def test_the_line_output_shows_once_why_a_case_is_held(events: list[Event]) -> None:
    text = "\n".join(line for event in events if (line := line_of(event)) is not None)
    assert text.count(REASON) == 1
    assert entry_of(events[-1]) is None
    assert text.endswith("held")


@pytest.mark.parametrize("quiet", [False, True])
def test_without_a_terminal_each_step_and_finding_gets_a_line_unless_quiet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], quiet: bool
) -> None:
    engine = RecordingCell(tmp_path).engine(plain_order("T1"))
    with observe_run(quiet=quiet) as watcher:
        watcher.opened(engine)
        engine.run_to(engine.order.find("image"))
        engine.find("the tracker is silent")
        engine.events.end()
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == ([] if quiet else ["done image (Image)", "note"])
